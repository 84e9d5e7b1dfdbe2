"""Bags written for tests: messages of zeros with some fields set."""

from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ctrl_rl_bags import BagWriter, Topic

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
STEP = 200_000_000


def build(kind: str, **fields):
    """Return a message of zeros with some fields set; a dict sets a nested message."""
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
    """Recorded drive: at step k the robot turns at 0.1 k rad/s and the command is 0.01 k m/s."""

    def __init__(self, folder: Path, kinds: dict[str, str]) -> None:
        self.folder, self.kinds = folder, kinds
        self.writer = BagWriter(folder)
        for name, kind in kinds.items():
            definition, _ = STORE.generate_msgdef(kind, ros_version=2)
            self.writer.add_topic(Topic(name, kind, definition, STORE.hash_rihs01(kind), ()))

    def put(self, topic: str, time: int, delay: int = 0, **fields) -> None:
        message = build(self.kinds[topic], **{"header": stamp(time), **fields})
        self.writer.write(topic, bytes(STORE.serialize_cdr(message, self.kinds[topic])), 10**12 + time + delay)

    def drive(
        self,
        steps: range,
        beams: int = 360,
        distance: float = 0.3,
        ranges=None,
        frame: str = "",
        commanded: bool = True,
    ) -> None:
        """Add scan, odometry and command of each step; the number of beams varies unless ranges are given."""
        for k in steps:
            given = np.full(beams + k % 3, distance, np.float32) if ranges is None else ranges
            self.put_step(k, given, (0.1, 0.1 * k), (0.01 * k, 0.0) if commanded else None, frame)

    def put_step(self, k: int, ranges, odometry, command, frame: str = "") -> None:
        time = k * STEP
        upright = {"pose": {"orientation": {"w": 1.0}}}
        self.put("/odom", time, pose=upright, twist={"twist": twist(*odometry)})
        header = {**stamp(time), "frame_id": frame}
        step = 2 * np.pi / len(ranges)
        angles = {"angle_increment": step, "angle_max": step * (len(ranges) - 1)}
        fields = {**angles, "range_max": 1000.0, "ranges": ranges}
        self.put("/scan", time, 1, **fields, header=header)
        if command is None:
            return
        if self.kinds["/cmd_vel"].endswith("Stamped"):
            self.put("/cmd_vel", time, 2, twist=twist(*command))
        else:
            self.put("/cmd_vel", time, 2, **twist(*command))

    def mount(self, frame: str, rotation: dict) -> None:
        """Write the mounting pose of the lidar on the robot."""
        kind = "geometry_msgs/msg/TransformStamped"
        transform = {"rotation": rotation}
        header = {"frame_id": "base_link"}
        one = build(kind, header=header, child_frame_id=frame, transform=transform)
        self.put("/tf_static", 0, transforms=[one])

    def __enter__(self) -> "Bag":
        return self

    def __exit__(self, *_) -> None:
        self.writer.close()
