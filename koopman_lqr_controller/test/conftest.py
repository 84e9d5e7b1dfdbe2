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


@pytest.fixture(scope="module")
def short_episodes() -> Iterator[None]:
    """Let the episodes of the control suite be short, and consolidation try few candidates."""
    import short_suite

    with pytest.MonkeyPatch.context() as patch:
        short_suite.shorten(patch.setattr)
        short_suite.shorten_consolidation(patch.setattr)
        yield
