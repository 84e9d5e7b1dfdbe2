"""Correct echo positions of a lidar on a turning robot, and rejection of impossible scans."""

import math

import numpy as np
import pytest
from ctrl_rl_safety.nodes.inputs import OdometryInput, beam_times
from nav_msgs.msg import Odometry

from ctrl_rl_core import ScanGeometry
from ctrl_rl_safety import SafetyError

SCAN = ScanGeometry(360, 0.0, math.pi / 180, 0.1, 5.0)
FORWARD, PERIOD = -0.03, 0.2
V, OMEGA = 0.2, 2.0


def odometry(time: float) -> Odometry:
    """Return odometry of a robot driving in a circle."""
    theta = OMEGA * time
    out = Odometry(child_frame_id="base")
    out.header.stamp.nanosec, out.header.frame_id = round(1e9 * time), "odom"
    out.pose.pose.position.x = V / OMEGA * math.sin(theta)
    out.pose.pose.position.y = V / OMEGA * (1.0 - math.cos(theta))
    out.pose.pose.orientation.z, out.pose.pose.orientation.w = math.sin(0.5 * theta), math.cos(0.5 * theta)
    out.twist.twist.linear.x, out.twist.twist.angular.z = V, OMEGA
    return out


def test_a_wall_is_straight_although_the_robot_turns_while_it_scans() -> None:
    track = OdometryInput(1.0, 1.0, 1.0)
    for time in np.arange(0.0, 0.45, 0.02):
        track.update(odometry(float(time)), float(time), round(1e9 * time))
    begin = 0.1
    beams, times = np.arange(20, 160), begin + PERIOD / SCAN.beams * np.arange(20, 160)
    theta = OMEGA * times
    y = V / OMEGA * (1.0 - np.cos(theta))
    lidar_y = y + FORWARD * np.sin(theta)
    bearing = SCAN.angle_increment * beams
    ranges = (1.0 - lidar_y) / np.sin(theta + bearing)  # the wall is at y = 1 m
    kept = (ranges > 0.0) & (ranges < 5.0)
    points = np.column_stack((FORWARD + ranges * np.cos(bearing), ranges * np.sin(bearing)))[kept]
    found = beam_times(points, SCAN, PERIOD / SCAN.beams, FORWARD, 1.0)
    np.testing.assert_allclose(found, times[kept] - begin, atol=1e-9)

    def off_the_wall(echoes: np.ndarray) -> float:
        _, py, heading = track.pose_at(round(1e9 * begin))
        return float(np.abs(py + np.sin(heading) * echoes[:, 0] + np.cos(heading) * echoes[:, 1] - 1.0).max())

    assert off_the_wall(points) > 0.1
    assert off_the_wall(track.straightened(points, found, round(1e9 * begin))) < 0.01
    assert track.straightened(points, np.zeros(len(points)), 0) is points


@pytest.mark.parametrize("increment", [math.nan, math.inf, -1e-4, 1.0])
def test_a_time_from_beam_to_beam_that_cannot_be_is_refused(increment: float) -> None:
    with pytest.raises(SafetyError, match="time_increment"):
        beam_times(np.ones((1, 2)), SCAN, increment, 0.0, 0.5)
