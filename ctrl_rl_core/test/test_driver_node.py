"""A driver node in one process: the driver's inputs, and the checks between driver and robot."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
import rclpy
from ctrl_rl_core.ros import initialise
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from ctrl_rl_core import DriverNode, NodeDriver, PolicyError, Sensors

BEAMS, STEP_NS = 90, 200_000_000


class Ahead(NodeDriver):
    """Drives straight ahead, and stores its inputs."""

    limits = np.array((0.0, -1.0)), np.array((0.3, 1.0))

    def __init__(self, _: DriverNode) -> None:
        self.seen: list[Sensors] = []
        self.told: list[tuple[tuple[float, ...], str]] = []
        self.refuses = False

    def command(self, sensors: Sensors) -> np.ndarray:
        self.seen.append(sensors)
        if self.refuses:
            raise PolicyError("the driver has no command")
        return np.array((0.2, 0.0))

    def on_sent(self, _: Header, command: np.ndarray, problem: str) -> None:
        self.told.append((tuple(command.tolist()), problem))


def half(_: Sensors, command: np.ndarray) -> np.ndarray:
    """Return half of a command."""
    return 0.5 * command


class Stand:
    """A driver node that receives scans and odometry directly."""

    def __init__(self) -> None:
        self.node = DriverNode("ahead", Ahead, half)
        assert isinstance(self.node.driver, Ahead)
        self.driver: Ahead = self.node.driver
        self._time, self._random = 10**12, np.random.default_rng(0)

    def scan(self, distance: float = 3.0) -> tuple[tuple[float, ...], str]:
        """Send odometry and a scan with this much clearance [m]; return the command sent, and the reason for a stop."""
        self._time += STEP_NS
        odometry = Odometry(child_frame_id="base_link")
        odometry.pose.pose.orientation.w = 1.0
        scan = LaserScan(angle_increment=math.tau / BEAMS, angle_max=math.tau * (BEAMS - 1) / BEAMS, range_min=0.1)
        scan.range_max, scan.ranges = 8.0, (distance + 0.01 * self._random.random(BEAMS)).tolist()
        for message in (odometry, scan):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(self._time, 10**9)
        self.node.robot.hear_odometry(odometry)
        self.node.robot.hear_scan(scan)
        return self.driver.told[-1]


@pytest.fixture
def stand() -> Iterator[Stand]:
    initialise(["test"])
    made = Stand()
    yield made
    made.node.destroy_node()
    rclpy.try_shutdown()


def test_the_driver_is_shown_sensors_and_its_filter_goes_before_it(stand: Stand) -> None:
    assert stand.scan() == ((0.1, 0.0), "")
    assert stand.scan() == ((0.1, 0.0), "")
    first, second = stand.driver.seen
    assert (first.command.tolist(), second.command.tolist()) == ([0.0, 0.0], [0.1, 0.0]), "what was sent is sensed"
    assert second.time - first.time == pytest.approx(0.2)
    assert second.scan.beams == BEAMS


def test_the_robot_stands_where_the_driver_or_the_scan_gives_a_reason(stand: Stand) -> None:
    stand.driver.refuses = True
    assert stand.scan() == ((0.0, 0.0), "the driver has no command")
    stand.driver.refuses = False
    command, problem = stand.scan(0.15)
    assert command == (0.0, 0.0)
    assert "obstacle" in problem
    assert stand.scan() == ((0.1, 0.0), "")
