"""Fixtures shared by tests of the nodes."""

from collections.abc import Iterator

import pytest


@pytest.fixture
def robot() -> Iterator[object]:
    """Return the robot driven by a controller."""
    from robot_side import Robot  # rclpy reads the tests' own domain when it is imported

    robot = Robot()
    yield robot
    robot.close()


@pytest.fixture(scope="module")
def short_episodes() -> Iterator[None]:
    """Shorten the episodes of the control suite and reduce the candidates of consolidation."""
    import short_suite

    with pytest.MonkeyPatch.context() as patch:
        short_suite.shorten(patch.setattr)
        short_suite.shorten_consolidation(patch.setattr)
        yield
