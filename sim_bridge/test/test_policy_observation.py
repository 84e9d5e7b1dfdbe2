"""The policy node's observation on topics equals that of the task environments."""

import pytest
from ctrl_rl_core.policies import ObservationBuilder
from sim_bridge.environments import NavigationEnv
from sim_bridge.simulation.options import SimulationOptions

from ctrl_rl_core import interface_of, load_navigation_task


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
            assert observe(environment.world.sensors()) == pytest.approx(wanted, abs=1e-6, rel=1e-6)
    finally:
        environment.close()
