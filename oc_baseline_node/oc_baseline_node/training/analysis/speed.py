"""CPU time of warm-started MPC (a few quadratic programs), compared with the interior point."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ctrl_rl_core import NavigationTask, Result
from oc_baseline_node.errors import OcError
from oc_baseline_node.mpc.initial_guess import shift_trajectory
from oc_baseline_node.mpc.mpc import Mpc
from oc_baseline_node.mpc.receding_horizon import RecedingHorizon
from oc_baseline_node.problems.problem import formulate
from oc_baseline_node.problems.start_states import draw_start

_DRIVES, _STEPS = 5, 40
_NOISE = 0.003
"""Standard deviation of the disturbance of each state in a step of a drive [m, rad, m/s, ...]."""


def warm_rows(
    task: NavigationTask, starts: int, seed: int = 0, progress: Callable[[], object] = lambda: None
) -> list[Result]:
    """Return result rows with the time of a warm start, and its cost relative to the interior point's.

    Each plan is solved from a random start; then the problem is solved again from the plan's next state, starting from
    the plan shifted by one step. The interior point receives the same state and plan. In drives, each state is
    additionally disturbed.

    Args:
        task: Task with an optimal control problem.
        starts: Number of plans.
        seed: Seed of the starts and of the disturbances.
        progress: Called after each plan.

    Raises:
        OcError: No start has a trajectory.
    """
    problem, random = formulate(task), np.random.default_rng(seed)
    ours, theirs = Mpc(problem), Mpc(problem, nearby=False)
    plans = []
    for _ in range(starts):
        plans.append(ours.solve(draw_start(problem, random)))
        progress()
    plans = [plan for plan in plans if plan.solved]
    if not plans:
        raise OcError(f"task '{task.name}': none of {starts} random starts has a trajectory: ask for more --starts")
    pairs = []
    for plan in plans:
        state, guess = plan.states[1], shift_trajectory(plan.states, plan.controls, 1)
        warm = ours.solve(state, guess, multipliers=ours.shift(plan.multipliers, 1))
        pairs.append((warm, theirs.solve(state, guess)))
    pairs = [(warm, cold) for warm, cold in pairs if warm.solved and cold.solved]
    above = [100.0 * (warm.cost - cold.cost) / abs(cold.cost) for warm, cold in pairs]
    nearby = [float(warm.reason.startswith("sqp")) for warm, _ in pairs]
    driven, alone = _drives(ours, [plan.states[0] for plan in plans[:_DRIVES]], random)
    name = task.name
    return [
        Result(name, "warm", "ms", [1e3 * warm.cpu_seconds for warm, _ in pairs]),
        Result(name, "cost above the interior point's", "%", above),
        Result(name, "solved by quadratic programs alone", "1", nearby),
        Result(name, "warm, in disturbed drives", "ms", driven),
        Result(name, "solved by quadratic programs alone, in disturbed drives", "1", alone),
        Result(f"{name}, interior point", "warm", "ms", [1e3 * cold.cpu_seconds for _, cold in pairs]),
    ]


def _drives(mpc: Mpc, starts: list[np.ndarray], random: np.random.Generator) -> tuple[list[float], list[float]]:
    """Return the time of each solution after the first in a drive [ms], and whether it came from quadratic programs."""
    seconds, alone = [], []
    for state in starts:
        controller = RecedingHorizon(mpc)
        for step in range(_STEPS):
            u = controller.control(state)
            if step and controller.solved and controller.plan is not None:
                seconds.append(1e3 * controller.spent)
                alone.append(float(controller.reason.startswith("sqp")))
            noise = random.normal(scale=_NOISE, size=len(state))
            state = mpc.problem.system.step(state, u, dt=mpc.problem.time_step) + noise
    return seconds, alone
