"""Solver result for one start, checked against every constraint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import signed_distance
from oc_baseline_node.mpc.transcription import trajectory_cost
from oc_baseline_node.problems.problem import OptimalControlProblem

Array = NDArray[np.float64]
TOLERANCE = 1e-4
"""Maximum violation of a constraint by a solved trajectory [m, rad, ...]."""
_CHECKED_FRACTIONS = (0.25, 0.5, 0.75)
"""Fractions of a step at which the clearance is checked."""


@dataclass(frozen=True)
class MpcSolution:
    """Solver result for one start.

    Attributes:
        states: States x_0 .. x_H (H+1, n); invalid unless `solved`. Angular states are continuous, even beyond a full
            turn.
        controls: Controls u_0 .. u_{H-1} (H, m).
        time_step: Duration of a step [s].
        solved: Whether the trajectory satisfies every constraint.
        reason: Status of the last solver (CasADi's return_status), or the reason why no solver was called.
        cost: Cost of Eq. 3.16; NaN unless solved.
        iterations: Total number of solver iterations, or of quadratic programs from a nearby trajectory.
        cpu_seconds: Total CPU time of the solvers [s], excluding the setup of their programs.
        multipliers: Multipliers of the constraints (M,), for warm starts; empty if unknown.
    """

    states: Array
    controls: Array
    time_step: float
    solved: bool
    reason: str
    cost: float
    iterations: int
    cpu_seconds: float
    multipliers: Array


def unsolved(
    problem: OptimalControlProblem, start: Array, reason: str, iterations: int = 0, seconds: float = 0.0
) -> MpcSolution:
    """Return an unsolved result for a start (n,)."""
    states = np.full((problem.horizon + 1, len(problem.system.states)), np.nan)
    states[0] = start if start.shape == states[0].shape else np.nan
    controls = np.full((problem.horizon, len(problem.system.controls)), np.nan)
    cost = float("nan")
    return MpcSolution(states, controls, problem.time_step, False, reason, cost, iterations, seconds, np.empty(0))


def checked(
    problem: OptimalControlProblem,
    start: Array,
    trajectory: tuple[Array, Array, float],
    reason: str,
    iterations: int,
    seconds: float,
    multipliers: Array,
) -> MpcSolution:
    """Return states (H+1, n), controls (H, m) and time step [s] as a result, solved if all constraints hold."""
    states, controls, time_step = trajectory
    with np.errstate(all="ignore"):
        broken = violated_constraint(problem, start, states, controls, time_step)
        if broken:
            return unsolved(problem, start, broken, iterations, seconds)
        cost = trajectory_cost(problem, states, controls, time_step)
    return MpcSolution(states, controls, time_step, True, reason, cost, iterations, seconds, multipliers)


def violated_constraint(
    problem: OptimalControlProblem, start: Array, states: Array, controls: Array, time_step: float
) -> str:
    """Name a constraint that a trajectory violates by more than the tolerance; obstacles are the real boxes."""
    low, high = problem.bounds_around(start)
    u_low, u_high = problem.system.control_bounds
    steps = problem.system.step(states[:-1], controls, dt=time_step)
    for step, index in np.argwhere(~np.isfinite(steps)):
        return f"the model's {problem.system.state_names[index]} at step {step + 1} is {steps[step, index]:g}"
    checks = {
        "start": np.abs(states[0] - start).max(),
        "dynamics": np.abs(states[1:] - steps).max(),
        "clearance": -problem.margin(states[1:]).min(),
        "clearance between samples": problem.clearance
        - _clearance_between_samples(problem, states, controls, time_step),
        "state bounds": max((low - states[1:]).max(), (states[1:] - high).max()),
        "control bounds": np.maximum(u_low - controls, controls - u_high).max(initial=-np.inf),
        "terminal set": problem.terminal_violation(states[-1]),
    }
    for name, violation in checks.items():
        if not violation <= TOLERANCE:
            return f"solution misses {name} by {violation:.2g}"
    return ""


def _clearance_between_samples(
    problem: OptimalControlProblem, states: Array, controls: Array, time_step: float
) -> float:
    """Return the minimum clearance of a trajectory between its samples [m], except in the first step.

    The start may lie at d_min, from where the first step may pass closer to a corner.
    """
    if not problem.obstacles:
        return np.inf
    between = [problem.system.step(states[1:-1], controls[1:], dt=part * time_step) for part in _CHECKED_FRACTIONS]
    return float(signed_distance(problem.obstacles, np.array(between)[..., problem.positions]).min())
