"""From bags to snapshots, on bags written for it."""

from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_core.bags import BagWriter, Topic
from koopman_lqr_controller.drives import snapshots_of
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.observables import CorridorObservables
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
MESSAGES = Path(__file__).parents[2] / "ctrl_rl_msgs" / "msg"
for _name in ("TaskOutcome", "EpisodeStatus"):
    STORE.register(get_types_from_msg((MESSAGES / f"{_name}.msg").read_text(), f"ctrl_rl_msgs/msg/{_name}"))
KINDS = {
    "/scan": "sensor_msgs/msg/LaserScan",
    "/odom": "nav_msgs/msg/Odometry",
    "/cmd_vel": "geometry_msgs/msg/TwistStamped",
    "/episode": "ctrl_rl_msgs/msg/EpisodeStatus",
}
OBSERVABLES = CorridorObservables()
STEP = 200_000_000


def build(kind: str, **fields):
    """Return a message of zeros with some fields set; a dict is a message of its own."""
    cls = STORE.types[kind]
    values = {}
    for name, (node, detail) in STORE.get_msgdef(kind).fields:
        given = fields.get(name)
        if node.name == "NAME":
            values[name] = build(detail, **(given or {}))
        elif node.name == "BASE":
            values[name] = given if given is not None else ("" if detail[0] == "string" else 0)
        elif node.name == "ARRAY":
            values[name] = np.zeros(detail[1])
        else:
            values[name] = given if given is not None else np.zeros(0, np.float32)
    return cls(**values)


def stamp(time: int) -> dict:
    return {"stamp": {"sec": time // 10**9, "nanosec": time % 10**9}, "frame_id": "base_link"}


def twist(v: float, omega: float) -> dict:
    return {"linear": {"x": v}, "angular": {"z": omega}}


class Bag:
    """A drive: at step k the robot turns at 0.1 k rad/s and the command is 0.01 k m/s."""

    def __init__(self, folder: Path, kinds: dict[str, str]) -> None:
        self.folder, self.kinds = folder, kinds
        self.writer = BagWriter(folder)
        for name, kind in kinds.items():
            definition, _ = STORE.generate_msgdef(kind, ros_version=2)
            self.writer.add_topic(Topic(name, kind, definition, STORE.hash_rihs01(kind), ()))

    def put(self, topic: str, time: int, delay: int = 0, **fields) -> None:
        message = build(self.kinds[topic], header=stamp(time), **fields)
        self.writer.write(topic, bytes(STORE.serialize_cdr(message, self.kinds[topic])), 10**12 + time + delay)

    def drive(self, steps: range, beams: int = 360, distance: float = 0.3) -> None:
        for k in steps:
            time = k * STEP
            self.put("/odom", time, twist={"twist": twist(0.1, 0.1 * k)})
            ranges = np.full(beams + k % 3, distance, np.float32)
            self.put("/scan", time, 1, angle_increment=2 * np.pi / len(ranges), range_max=3.5, ranges=ranges)
            if self.kinds["/cmd_vel"].endswith("Stamped"):
                self.put("/cmd_vel", time, 2, twist=twist(0.01 * k, 0.0))
            else:
                self.put("/cmd_vel", time, 2, **twist(0.01 * k, 0.0))

    def __enter__(self) -> "Bag":
        return self

    def __exit__(self, *_) -> None:
        self.writer.close()


def without(*names: str, **changed: str) -> dict[str, str]:
    return {name: changed.get(name.strip("/"), kind) for name, kind in KINDS.items() if name not in names}


@pytest.mark.parametrize("command", ["geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"])
def test_each_step_brings_state_command_and_next_state(tmp_path: Path, command: str) -> None:
    with Bag(tmp_path / "bag", without("/episode", cmd_vel=command)) as bag:
        bag.drive(range(6))
    (snapshots,) = snapshots_of(tmp_path / "bag", OBSERVABLES)
    turn_rate = OBSERVABLES.names.index("turn rate")
    k = np.arange(5)
    np.testing.assert_allclose(snapshots.z[:, turn_rate], 0.1 * k, atol=1e-6)
    np.testing.assert_allclose(snapshots.z_next[:, turn_rate], 0.1 * (k + 1), atol=1e-6)
    np.testing.assert_allclose(snapshots.u[:, 0], 0.01 * k, atol=1e-9)


def test_a_lost_scan_and_a_blind_one_part_the_drive(tmp_path: Path) -> None:
    with Bag(tmp_path / "bag", without("/episode")) as bag:
        bag.drive(range(4))
        bag.drive(range(5, 9))
        bag.drive(range(9, 10), distance=np.nan)
        bag.drive(range(10, 13))
    assert [len(piece.u) for piece in snapshots_of(tmp_path / "bag", OBSERVABLES)] == [3, 3, 2]


def test_what_follows_an_outcome_is_left_out(tmp_path: Path) -> None:
    with Bag(tmp_path / "bag", KINDS) as bag:
        for k in range(9):
            outcome = 1 if k in (4, 5) else 0
            bag.put("/episode", k * STEP, episode=int(k > 5), outcome={"value": outcome})
            bag.drive(range(k, k + 1))
    assert [len(piece.u) for piece in snapshots_of(tmp_path / "bag", OBSERVABLES)] == [3, 2]


def test_says_which_topic_is_missing_and_when_nothing_is_usable(tmp_path: Path) -> None:
    with Bag(tmp_path / "a", without("/odom", "/episode")) as bag:
        bag.writer.flush()
    with pytest.raises(KoopmanError, match=r"no topic /odom; it has /cmd_vel, /scan"):
        snapshots_of(tmp_path / "a", OBSERVABLES)
    with Bag(tmp_path / "b", without("/episode")) as bag:
        bag.drive(range(1))
    with pytest.raises(KoopmanError, match="was the robot driven"):
        snapshots_of(tmp_path / "b", OBSERVABLES)
