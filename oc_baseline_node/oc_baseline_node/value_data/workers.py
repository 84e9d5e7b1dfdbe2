"""Making value data in several processes, with a progress bar; finished chunks are kept when it is stopped."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from ctrl_rl_core.processes.ray_workers import Tell, map_in_ray, require_ray
from tqdm import tqdm

from ctrl_rl_core import NavigationTask, exclusive_lock, map_in_processes
from oc_baseline_node.problems.problem import Form, OptimalControlProblem, formulate
from oc_baseline_node.value_data.chunk_solver import ChunkSolver
from oc_baseline_node.value_data.dataset import (
    LOCK,
    DataSettings,
    ValueData,
    load_data,
    make_folder,
    open_folder,
    write_chunk,
)

_solver: ChunkSolver
"""One to a worker process: setting up the programs takes as long as a chunk does."""


def make_data(
    problem: OptimalControlProblem,
    settings: DataSettings,
    folder: Path,
    workers: int = 1,
    progress: bool = True,
    ray: str | None = None,
) -> tuple[ValueData, float, float]:
    """Make what a folder of value data still lacks and return all of it, with the wall and CPU seconds that it took.

    Args:
        problem: to solve, as `formulate` made it.
        settings: Number of trajectories, size of a chunk and seed.
        folder: holds one file a chunk; what lies there is not made again.
        workers: processes; with one everything happens in this one.
        progress: whether to show a bar.
        ray: Address of a Ray cluster that solves as many chunks at a time as it can; None for processes.

    Raises:
        OcError: The folder holds something else, or hardly any start has a trajectory.
        LockError: another call works in the folder.
        WorkersError: a worker was killed.
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
            for index in finished:
                bar.update(settings.size(index))
        return load_data(folder, problem), time.monotonic() - wall, _cpu_seconds() - cpu


def _finished(
    problem: OptimalControlProblem, settings: DataSettings, folder: Path, lacking: list[int], workers: int
) -> Iterator[int]:
    """Make the chunks and yield each one's index once its file is there."""
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
) -> Iterator[int]:
    """Let a cluster solve the chunks, write them here and yield each one's index."""
    if not lacking:
        return
    solve = partial(_solve_there, (problem.task, problem.form, problem.clearance, settings))
    for index, data in map_in_ray(address, solve, lacking, folder, shared=True):  # it writes nothing there
        write_chunk(folder, index, data)
        yield index


def _solve_there(
    terms: tuple[NavigationTask, Form, float, DataSettings], index: int, _: Path, __: Tell
) -> tuple[int, ValueData]:
    if _prepared != [terms]:
        _prepare(*terms)
        _prepared[:] = [terms]
    return index, _solver.solve(index)


_prepared: list[Any] = []
"""Terms of the solver that this worker has."""


def _prepare(task: NavigationTask, form: Form, clearance: float, settings: DataSettings) -> None:
    global _solver
    _solver = ChunkSolver(formulate(task, form, clearance), settings)


def _make(folder: Path, index: int) -> int:
    write_chunk(folder, index, _solver.solve(index))
    return index


def _cpu_seconds() -> float:
    """Return CPU seconds of this process and of those it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
