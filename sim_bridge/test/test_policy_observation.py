"""What the policy node observes on topics is what the environments of the same tasks observe."""

import numpy as np
import pytest
from ctrl_rl_core.driving.scan import ScanGeometry
from ctrl_rl_core.policies.observation import ObservationBuilder
from nav_msgs.msg import Odometry
from sim_bridge.environments import NavigationEnv
from sim_bridge.ros.publishers import fill_odometry
from sim_bridge.simulation.options import SimulationOptions

from ctrl_rl_core import Sensors, interface_of, load_navigation_task


def sensors_of(world) -> Sensors:
    """Return what the bridge would publish now."""
    message, reading = Odometry(), world.odometry(0)
    fill_odometry(message, world.plane, 0, reading)
    seen = world.laser_scan(0)
    scan = ScanGeometry(len(seen.ranges), seen.angle_min, seen.angle_increment, seen.range_min, seen.range_max)
    x, y, theta = reading.pose
    pose = np.array((x, y, (theta + np.pi) % (2 * np.pi) - np.pi))
    return Sensors(seen.ranges, scan, message, pose, None, np.zeros(2))


@pytest.mark.parametrize("name", ["car_ttr", "car_navigation", "quad_ttr", "quad_navigation", "curved_corridor"])
def test_the_node_observes_what_the_environment_observes(name: str) -> None:
    task = load_navigation_task(name)
    environment = NavigationEnv(task, options=SimulationOptions(scan_noise=0.0, scan_dropout=0.0))
    observe = ObservationBuilder(interface_of(task))
    try:
        environment.reset(seed=4)
        environment.action_space.seed(4)
        for _ in range(4):
            wanted, *_ = environment.step(environment.action_space.sample())
            assert observe(sensors_of(environment.world)) == pytest.approx(wanted, abs=1e-6, rel=1e-6)
    finally:
        environment.close()
