"""A chunk of value data from random starts (thesis 3.3.2).

A chunk draws starts from its own generator until it has its share of solved trajectories, so that the data depend on
seed and chunk size alone, not on how many processes made them or how often they were stopped.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ctrl_rl_core import Region
from oc_baseline_node.errors import OcError
from oc_baseline_node.mpc.initial_guess import braking_guess
from oc_baseline_node.mpc.mpc import Mpc, MpcSolution
from oc_baseline_node.problems.problem import OptimalControlProblem
from oc_baseline_node.problems.start_states import draw_start
from oc_baseline_node.value_data.dataset import DataSettings, ValueData

_LOOK_AHEAD_S = 1.0
_MOST_STARTS = 20
"""Starts tried for each trajectory wanted, before a chunk gives up."""


class ChunkSolver:
    """Makes chunks of a problem's value data; its programs are set up once."""

    def __init__(self, problem: OptimalControlProblem, settings: DataSettings) -> None:
        self._problem = problem
        self._settings = settings
        self._mpc = Mpc(problem)
        look_ahead = max(1, round(_LOOK_AHEAD_S / problem.time_step))
        # No goal that pulls into an obstacle: only to keep clear, at the least control.
        self._clear = replace(
            problem, horizon=look_ahead, terminal=Region(), gamma=1.0, state_weight=0.0, trap_weight=0.0
        )
        self._keeps_clear = Mpc(self._clear)

    def solve(self, index: int) -> ValueData:
        """Return chunk `index`.

        Raises:
            OcError: hardly any start has a trajectory.
        """
        random = np.random.default_rng([self._settings.seed, index])
        wanted = self._settings.size(index)
        solved: list[MpcSolution] = []
        unsolved: list[MpcSolution] = []
        doomed: list[bool] = []
        while len(solved) < wanted:
            trajectory = self._mpc.solve(draw_start(self._problem, random))
            if trajectory.solved:
                solved.append(trajectory)
                continue
            unsolved.append(trajectory)
            start = trajectory.states[0]
            doomed.append(not self._keeps_clear.solve(start, braking_guess(self._clear, start)).solved)
            if len(unsolved) >= _MOST_STARTS * wanted:
                raise OcError(f"only {len(solved)} of {len(solved) + len(unsolved)} random starts have a trajectory; "
                              f"the last solver said '{trajectory.reason}'")  # fmt: skip
        n = len(self._problem.system.states)
        return ValueData(
            states=np.array([t.states for t in solved]),
            controls=np.array([t.controls for t in solved]),
            time_steps=np.array([t.time_step for t in solved]),
            cpu_seconds=np.array([t.cpu_seconds for t in solved]),
            unsolved=np.array([t.states[0] for t in unsolved]).reshape(-1, n),
            reasons=tuple(t.reason for t in unsolved),
            doomed=np.array(doomed, dtype=bool),
            wasted_seconds=np.array([t.cpu_seconds for t in unsolved]),
        )
