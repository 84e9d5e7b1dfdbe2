"""What tests of the nodes share."""

from collections.abc import Iterator

import pytest


@pytest.fixture
def robot() -> Iterator[object]:
    """Give the robot that a controller drives."""
    from robot_side import Robot  # rclpy reads the tests' own domain when it is imported

    robot = Robot()
    yield robot
    robot.close()
