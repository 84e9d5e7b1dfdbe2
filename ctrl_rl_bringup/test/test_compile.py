"""The command `compile` leaves machine code of the kernels that nodes compute with."""

import pytest
from ctrl_rl_bringup.cli.compile import KERNELS
from ctrl_rl_core.values import gradient_at, value_at, values_at
from ctrl_rl_navigation.driving import choose
from ctrl_rl_navigation.values import march
from ctrl_rl_safety.flight import best_escape, nearest_safe, record
from ttr_reward_node.kernels import kernels

from ctrl_rl_safety import answer

COMPILED = {
    "safety filter": [answer],
    "flight guard": [best_escape, nearest_safe, record],
    "time to reach": [kernels().find_outcomes, kernels().sweep],
    "time to reach, node by node": [kernels().find_outcomes, kernels().sweep_nodes],
    "navigator": [choose, march],
    "values of cars": [value_at, values_at, gradient_at],
    "values of quadrotors": [value_at, values_at, gradient_at],
}


@pytest.mark.parametrize("name", KERNELS)
def test_what_a_node_computes_with_is_compiled(name: str) -> None:
    KERNELS[name]()
    assert all(kernel.signatures for kernel in COMPILED[name])
