"""Define your own system, solve its time to reach, and compare it with the known solution.

The system is a cart that accelerates and brakes. From rest at distance d it needs 2 sqrt(d) to rest at the origin.

python examples/own_system.py
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ctrl_rl_core import SYSTEM_MODELS, Axis, Interval, Quantity, Region, SystemModel, make_system
from ttr_reward_node import TimeToReachProblem, solve


def cart(_math: Any, _parameters: Mapping[str, float]) -> Any:
    """Return f(x, u, d) for the state (x, v) and the acceleration as control."""

    def f(x: Any, u: Any, d: Any) -> tuple[Any, Any]:
        return x[1] + d[0], u[0] + d[1]

    return f


SYSTEM_MODELS["cart"] = SystemModel(
    states=(Quantity("x", "m"), Quantity("v", "m/s", -2.0, 2.0)),
    controls=(Quantity("a", "m/s^2", -1.0, 1.0),),
    parameters=(),
    equations=cart,
)
problem = TimeToReachProblem(
    system=make_system("cart"),
    axes=(Axis("x", "m", -2.0, 2.0, 161), Axis("v", "m/s", -2.0, 2.0, 161)),
    target=Region({"x": Interval(-0.05, 0.05), "v": Interval(-0.05, 0.05)}),
)
solution = solve(problem)
for distance in (0.5, 1.0, 1.5):
    (seconds,) = np.asarray(solution.grid.value([[distance, 0.0]]))
    print(f"from rest at {distance} m: {seconds:.2f} s into the target box, {2 * distance**0.5:.2f} s to its middle")
