"""Generates value data from random starts (thesis 3.3.2), chunk by chunk, in several processes or on a Ray cluster.

A chunk draws starts from its own generator until it has enough solved trajectories. The data therefore depends only on
seed and chunk size, not on the number of processes or on interruptions.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.processes import Tell, map_in_ray, require_ray
from tqdm import tqdm

from ctrl_rl_core import NavigationTask, Region, exclusive_lock, map_in_processes
from oc_baseline_node.errors import OcError
from oc_baseline_node.mpc.initial_guess import braking_guess
from oc_baseline_node.mpc.limited import seconds_elsewhere
from oc_baseline_node.mpc.mpc import Mpc
from oc_baseline_node.mpc.solution import MpcSolution
from oc_baseline_node.problems.problem import Form, OptimalControlProblem, formulate
from oc_baseline_node.problems.start_states import draw_start
from oc_baseline_node.value_data.dataset import (
    LOCK,
    DataSettings,
    ValueData,
    load_data,
    make_folder,
    open_folder,
    write_chunk,
)

_LOOK_AHEAD_S = 1.0
_MOST_STARTS = 20
"""Maximum number of starts per trajectory before a chunk is abandoned."""


class ChunkSolver:
    """Generates chunks of a problem's value data; sets up the programs once."""

    def __init__(self, problem: OptimalControlProblem, settings: DataSettings) -> None:
        self._problem = problem
        self._settings = settings
        self._mpc = Mpc(problem)
        look_ahead = max(1, round(_LOOK_AHEAD_S / problem.time_step))
        # Without a goal that pulls into an obstacle: only stay clear, with little control.
        self._clear = replace(
            problem, horizon=look_ahead, terminal=Region(), gamma=1.0, state_weight=0.0, trap_weight=0.0
        )
        self._keeps_clear = Mpc(self._clear)

    def solve(self, index: int) -> ValueData:
        """Generate chunk `index`.

        Raises:
            OcError: Almost no start has a trajectory.
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


_solver: ChunkSolver
"""Solver of a worker process, created once because the setup takes as long as a chunk."""


def make_data(
    problem: OptimalControlProblem,
    settings: DataSettings,
    folder: Path,
    workers: int = 1,
    progress: bool = True,
    ray: str | None = None,
) -> tuple[ValueData, float, float]:
    """Complete a folder of value data; return all data, and the wall and CPU time taken [s].

    Args:
        problem: Optimal control problem from `formulate`.
        settings: Number of trajectories, size of a chunk and seed.
        folder: Folder with one file per chunk; existing chunks are kept.
        workers: Number of worker processes; 1 to use only this process.
        progress: Whether to show a progress bar.
        ray: Address of a Ray cluster that solves as many chunks in parallel as it can; None for local processes.

    Raises:
        OcError: The folder has other content, or almost no start has a trajectory.
        LockError: Another process is using the folder.
        WorkersError: A worker was killed.
    """
    wall, cpu = time.monotonic(), _cpu_seconds()
    if ray is not None:
        require_ray()
    make_folder(folder)
    with exclusive_lock(folder / LOCK):
        lacking = open_folder(folder, problem, settings)
        done = settings.trajectories - sum(map(settings.size, lacking))
        quiet = None if progress else True
        with tqdm(total=settings.trajectories, initial=done, desc="solving", unit="trajectory", disable=quiet) as bar:
            if ray is None:
                finished = _finished(problem, settings, folder, lacking, min(workers, max(1, len(lacking))))
            else:
                finished = _finished_by_ray(ray, problem, settings, folder, lacking)
            elsewhere = 0.0
            for index, seconds in finished:
                elsewhere += seconds
                bar.update(settings.size(index))
        return load_data(folder, problem), time.monotonic() - wall, _cpu_seconds() - cpu + elsewhere


def _finished(
    problem: OptimalControlProblem, settings: DataSettings, folder: Path, lacking: list[int], workers: int
) -> Iterator[tuple[int, float]]:
    """Generate the chunks; yield the index of each finished one and the CPU time of its solver processes [s]."""
    if not lacking:
        return
    terms = (problem.task, problem.form, problem.clearance, settings)
    if workers == 1:
        _prepare(*terms)
        yield from (_make(folder, index) for index in lacking)
    else:
        yield from map_in_processes(partial(_make, folder), lacking, workers, _prepare, terms)


def _finished_by_ray(
    address: str, problem: OptimalControlProblem, settings: DataSettings, folder: Path, lacking: list[int]
) -> Iterator[tuple[int, float]]:
    """Solve the chunks on a cluster and write them here; yield each index, with zero local CPU time."""
    if not lacking:
        return
    solve = partial(_solve_there, (problem.task, problem.form, problem.clearance, settings))
    for index, data in map_in_ray(address, solve, lacking, folder, shared=True):  # workers write nothing there
        write_chunk(folder, index, data)
        yield index, 0.0


def _solve_there(
    terms: tuple[NavigationTask, Form, float, DataSettings], index: int, _: Path, __: Tell
) -> tuple[int, ValueData]:
    if _prepared != [terms]:
        _prepare(*terms)
        _prepared[:] = [terms]
    return index, _solver.solve(index)


_prepared: list[Any] = []
"""Settings of this worker's solver."""


def _prepare(task: NavigationTask, form: Form, clearance: float, settings: DataSettings) -> None:
    global _solver
    _solver = ChunkSolver(formulate(task, form, clearance), settings)


def _make(folder: Path, index: int) -> tuple[int, float]:
    begin = seconds_elsewhere()
    write_chunk(folder, index, _solver.solve(index))
    return index, seconds_elsewhere() - begin


def _cpu_seconds() -> float:
    """Return the CPU time of this process and its finished children [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
