"""Systems and grids of the scaling of the time to reach."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ctrl_rl_core import Axis, Interval, Quantity, Region, System
from ttr_reward_node import TimeToReachProblem, problem_from_task

GRIDS = {
    "car": ((51, 51, 36), (101, 101, 72)),
    "pendulum pair": ((13,) * 4, (17,) * 4),
    "planar quadrotor, undecomposed": ((12,) * 6, (20,) * 6),
}


def problem_of(name: str, counts: tuple[int, ...]) -> TimeToReachProblem:
    """Return a system of GRIDS on a grid, without obstacles."""
    if name == "pendulum pair":
        return _pendulum_pair(counts)
    task = problem_from_task("car_ttr" if name == "car" else "quad_ttr")
    axes = tuple(replace(axis, count=count) for axis, count in zip(task.axes, counts, strict=True))
    return replace(task, axes=axes, clearance=None)


def _pendulum_pair(counts: tuple[int, ...]) -> TimeToReachProblem:
    """Return two upright pendulums that a spring couples: every derivative of a speed depends on three states."""

    def equations(math: Any, _p: Any) -> Any:
        def rates(x: Any, u: Any, _d: Any) -> Any:
            pull = math.sin(x[2] - x[0])
            return x[1], math.sin(x[0]) + 0.5 * pull + u[0], x[3], math.sin(x[2]) - 0.5 * pull + u[1]

        return rates

    states = tuple(Quantity(n, u) for n, u in (("a", "rad"), ("v", "rad/s"), ("b", "rad"), ("w", "rad/s")))
    system = System(
        name="pendulum pair",
        states=states,
        controls=tuple(Quantity(name, "1", -1.0, 1.0) for name in ("torque_a", "torque_b")),
        disturbances=tuple(Quantity(f"d_{s.name}", f"{s.unit}/s", 0.0, 0.0) for s in states),
        parameters={},
        equations=equations,
    )
    axes = tuple(Axis(s.name, s.unit, -1.6, 1.6, count) for s, count in zip(states, counts, strict=True))
    return TimeToReachProblem(system, axes, Region({s.name: Interval(-0.4, 0.4) for s in states}))
