"""Koopman policies in the core's policy node: the same commands, and a stop outside of the training region."""

import numpy as np
import pytest

import koopman_lqr_controller as koopman
from ctrl_rl_core import ScanGeometry, Sensors, find_policy, load_policy, make_odometry

LIDAR = ScanGeometry(360, 0.0, 2.0 * np.pi / 360, 0.12, 3.5)


def corridor(offset: float) -> np.ndarray:
    """Return the ranges between two straight walls, 0.65 m apart."""
    side = np.sin(LIDAR.angle_increment * np.arange(LIDAR.beams))
    with np.errstate(divide="ignore"):
        ranges = np.where(side > 0.0, (0.325 - offset) / side, -(0.325 + offset) / side)
    return np.minimum(ranges, np.float32(3.5)).astype(np.float32)


@pytest.mark.parametrize("name", ["curved_corridor", "curved_corridor_edmd"])
def test_the_policy_node_gets_the_commands_of_the_controller(name: str) -> None:
    policy, driving = koopman.load_policy(koopman.find_policy(name)), load_policy(find_policy(name))
    odometry = make_odometry(np.zeros(3), np.array((0.15, 0.0, 0.1)))
    for offset in (-0.05, 0.0, 0.04):
        ranges = corridor(offset)
        sensors = Sensors(ranges, LIDAR, odometry, None, None, np.zeros(2))
        assert driving.command(sensors) == pytest.approx(policy.decide(ranges, LIDAR, 0.15, 0.1).command)
    assert (driving.limits[0] == policy.limits[0]).all()
    odometry = make_odometry(np.zeros(3), np.array((3.0, 0.0, 20.0)))
    with pytest.raises(koopman.KoopmanError, match="has left the region seen in training"):
        driving.command(Sensors(corridor(0.0), LIDAR, odometry, None, None, np.zeros(2)))
