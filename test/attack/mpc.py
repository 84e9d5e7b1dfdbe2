"""MPC of random models whose equations have no derivative, or no value, where a trajectory begins or leads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from _attack import Attack
from _singular_models import random_problem

from oc_baseline_node import Mpc, MpcSolution

TIME_LIMIT = 10.0
"""Processor time of a start [s]."""
_ROOM = 1.5
"""What a start may take in all, in time limits: setting up a solver's process is not in it."""


def solve_one(random: np.random.Generator, folder: Path) -> tuple[MpcSolution, str]:
    """Return the result of MPC for one random model, and what the model holds.

    Raises:
        AssertionError: It took longer than its limit, gave no reason, or called a trajectory solved that is none.
    """
    problem, start, names = random_problem(random, folder)
    trajectory = Mpc(problem, time_limit=TIME_LIMIT).solve(start)
    assert trajectory.cpu_seconds <= _ROOM * TIME_LIMIT, f"{names}: {trajectory.cpu_seconds:.3g} s"
    assert trajectory.reason, f"{names}: no reason"
    assert len(trajectory.reason.splitlines()) == 1, f"{names}: {trajectory.reason}"
    if trajectory.solved:
        with np.errstate(all="ignore"):
            steps = problem.system.step(trajectory.states[:-1], trajectory.controls, dt=trajectory.time_step)
        assert np.abs(steps - trajectory.states[1:]).max() <= 1e-4, f"{names}: its dynamics are not the model's"
        assert problem.terminal_violation(trajectory.states[-1]) <= 1e-4, f"{names}: it does not arrive"
    return trajectory, names


def singular(random: np.random.Generator, folder: Path) -> None:
    """Solve for a random model: a trajectory or one line, within the limit."""
    solve_one(random, folder)


ATTACKS = (
    Attack(
        "mpc-singular",
        "MPC of a model with singular derivatives ends, with a trajectory of that model or one line.",
        singular,
    ),
)
