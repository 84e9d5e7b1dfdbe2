"""Snapshots from bags, on bags written for the tests."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.data.trajectory_segments import split
from recorded import KINDS, STEP, Bag

from ctrl_rl_bags import BagError
from koopman_lqr_controller import CorridorObservables, KoopmanError, TrajectorySegment, load_segments, to_snapshots

OBSERVABLES = CorridorObservables()
SEE = OBSERVABLES.observe


def without(*names: str, **changed: str) -> dict[str, str]:
    return {name: changed.get(name.strip("/"), kind) for name, kind in KINDS.items() if name not in names}


@pytest.mark.parametrize("command", ["geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"])
def test_each_step_brings_state_command_and_next_state(tmp_path: Path, command: str) -> None:
    with Bag(tmp_path / "bag", without("/episode", cmd_vel=command)) as bag:
        bag.drive(range(6))
    (snapshots,) = to_snapshots(load_segments(tmp_path / "bag", SEE))
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
    assert [len(piece.u) for piece in to_snapshots(load_segments(tmp_path / "bag", SEE))] == [3, 3, 2]


def test_what_follows_an_outcome_is_left_out(tmp_path: Path) -> None:
    with Bag(tmp_path / "bag", KINDS) as bag:
        for k in range(9):
            outcome = 1 if k in (4, 5) else 0
            bag.put("/episode", k * STEP, episode=int(k > 5), outcome={"value": outcome})
            bag.drive(range(k, k + 1))
    assert [len(piece.u) for piece in to_snapshots(load_segments(tmp_path / "bag", SEE))] == [3, 2]


def test_says_which_topic_is_missing_and_when_nothing_is_usable(tmp_path: Path) -> None:
    with Bag(tmp_path / "a", without("/odom", "/episode")) as bag:
        bag.writer.flush()
    with pytest.raises(BagError, match=r"no topic /odom \(nav_msgs/msg/Odometry\); it has /cmd_vel, /scan"):
        load_segments(tmp_path / "a", SEE)
    with Bag(tmp_path / "b", without("/episode")) as bag:
        bag.drive(range(1))
    with pytest.raises(BagError, match="no two usable scans"):
        load_segments(tmp_path / "b", SEE)
    with Bag(tmp_path / "c", without("/episode")) as bag:
        bag.drive(range(5), distance=np.nan)
    with pytest.raises(KoopmanError, match="was the robot driven"):
        load_segments(tmp_path / "c", SEE)


def test_the_lidar_is_taken_as_it_is_mounted(tmp_path: Path) -> None:
    """The left half of the view of a lidar that faces left is behind the robot."""
    kinds = {**without("/episode"), "/tf_static": "tf2_msgs/msg/TFMessage"}

    def ahead(ranges, scan, _v, _omega):
        return np.array([ranges[round((0.0 - scan.angle_min) / scan.angle_increment) % scan.beams]])

    for name, turned, expected in (("level", 0.5**0.5, 270.0), ("tilted", 0.0, None)):
        with Bag(tmp_path / name, kinds) as bag:
            rotation = {"z": turned, "w": turned} if turned else {"x": 1.0}
            bag.mount("laser", rotation)
            for k in range(3):
                ranges = np.arange(360, dtype=np.float32)
                bag.drive(range(k, k + 1), ranges=ranges, frame="laser")
        if expected is None:
            with pytest.raises(KoopmanError, match="does not lie flat and upright"):
                load_segments(tmp_path / name, ahead)
        else:
            (drive,) = load_segments(tmp_path / name, ahead)
            assert drive.x[0, 0] == expected
        (drive,) = load_segments(tmp_path / name, ahead, lidar_yaw=0.0)
        assert drive.x[0, 0] == 0.0


def test_a_lidar_that_hangs_from_nothing_known_is_asked_for(tmp_path: Path) -> None:
    kinds = {**without("/episode"), "/tf_static": "tf2_msgs/msg/TFMessage"}
    with Bag(tmp_path / "bag", kinds) as bag:
        bag.mount("laser", {"w": 1.0})
        bag.drive(range(3), frame="front_laser")
    with pytest.raises(KoopmanError, match="from the scan to a base, only to front_laser: --lidar-yaw"):
        load_segments(tmp_path / "bag", lambda *_: np.zeros(1))


def test_a_command_of_long_ago_does_not_count(tmp_path: Path) -> None:
    with Bag(tmp_path / "bag", without("/episode", cmd_vel="geometry_msgs/msg/Twist")) as bag:
        bag.drive(range(4))
        bag.drive(range(4, 15), commanded=False)
    (drive,) = load_segments(tmp_path / "bag", lambda *_: np.zeros(1))
    assert len(drive) == 8, "the last command, of step 3, holds for the five steps of a second"


@settings(deadline=None)
@given(st.lists(st.integers(1, 9), min_size=1, max_size=5), st.floats(0.0, 1.0))
def test_the_last_part_is_held_out(lengths: list[int], held_out: float) -> None:
    drives = [
        TrajectorySegment(np.arange(n + 1.0)[:, None] + 100 * i, np.zeros((n, 2)), 0.2) for i, n in enumerate(lengths)
    ]
    seen, unseen = split(drives, held_out)
    assert sum(map(len, unseen)) == round(held_out * sum(lengths))
    steps = [(x, after) for part in (*seen, *unseen) for x, after in zip(part.x[:-1, 0], part.x[1:, 0], strict=True)]
    assert steps == [(x, x + 1) for drive in drives for x in drive.x[:-1, 0]]
