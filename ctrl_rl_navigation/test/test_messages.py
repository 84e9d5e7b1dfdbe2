"""What the navigator publishes stays small enough to leave time for commands, and so does what it takes in."""

from collections.abc import Iterator

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from ctrl_rl_navigation.nodes.messages import path_message, slice_message
from ctrl_rl_navigation.nodes.navigator_node import NavigatorNode
from ctrl_rl_navigation.values.map_value import MapValue
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from ctrl_rl_core import OccupancyMap


def test_a_long_path_has_few_poses_from_its_start_to_its_end() -> None:
    path = np.column_stack((np.linspace(0.0, 300.0, 20_001), np.zeros(20_001)))
    poses = path_message(path, Header()).poses
    assert len(poses) <= 202
    assert (poses[0].pose.position.x, poses[-1].pose.position.x) == (0.0, 300.0)


@pytest.mark.parametrize(("side", "step"), [(400, 1), (2500, 3)])
def test_the_times_of_a_large_map_are_shown_at_a_coarser_resolution(side: int, step: int) -> None:
    map_ = OccupancyMap(np.zeros((side, side), np.int8), 0.05, (1.0, 2.0, 0.0))
    away = np.hypot(*np.mgrid[:side, :side]).astype(np.float32)
    away[:, side // 2 :] = np.inf
    shown = slice_message(MapValue(away, map_, (0.0, 0.0), 0.1, 1.0), Time(), "map")
    assert shown.info.resolution == pytest.approx(0.05 * step)
    assert shown.info.width * shown.info.height <= 1_000_000
    assert shown.info.width * shown.info.resolution == pytest.approx(0.05 * side, abs=0.05 * step)
    assert (shown.info.origin.position.x, shown.info.origin.position.y) == (1.0, 2.0)
    data = np.array(shown.data, np.int8).reshape(shown.info.height, shown.info.width)
    assert (data[0, 0], data[:, : shown.info.width // 2 - 1].max(), data[0, -1]) == (0, 100, -1)


@pytest.fixture
def node() -> Iterator[NavigatorNode]:
    rclpy.init(args=["--ros-args", "-p", "map:=corridor"])
    node = NavigatorNode()
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def test_of_a_flood_of_scans_some_and_the_last_one_are_processed(
    node: NavigatorNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[float] = []
    monkeypatch.setattr(node._driver, "see", lambda sensors: seen.append(float(sensors.ranges[0])))
    for number in range(1, 201):
        scan = LaserScan(angle_max=6.2657, angle_increment=0.017453, range_min=0.1, range_max=999.0)
        scan.ranges = [float(number)] * 360
        node.robot.hear_scan(scan)
    node._tick()
    assert seen == [1.0, 2.0, 3.0, 4.0, 200.0]
    node.robot.hear_scan(scan)
    assert len(seen) == 6
