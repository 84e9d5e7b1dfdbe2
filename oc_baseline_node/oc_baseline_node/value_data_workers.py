"""Making value data with several processes, with a progress bar; what is done stays done when it is stopped."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait as wait_for_any
from pathlib import Path

from ctrl_rl_core.tasks import NavigationTask
from tqdm import tqdm

from oc_baseline_node.chunk_solver import ChunkSolver
from oc_baseline_node.errors import OcError
from oc_baseline_node.problem import Form, Problem, formulate
from oc_baseline_node.value_data import DataSettings, ValueData, load_data, open_folder, write_chunk

_solver: ChunkSolver
"""One to a worker process: setting up the programs takes as long as a chunk does."""


def make_data(
    problem: Problem, settings: DataSettings, folder: Path, workers: int = 1, progress: bool = True
) -> tuple[ValueData, float, float]:
    """Make what a folder of value data still lacks and return all of it, with the wall and CPU seconds that it took.

    Args:
        problem: to solve, as `formulate` made it.
        settings: how many, from which seed.
        folder: holds one file a chunk; what lies there is not made again.
        workers: processes; with one everything happens in this one.
        progress: whether to show a bar.

    Raises:
        OcError: see `open_folder` and `ChunkSolver.solve`, or a worker was killed.
    """
    lacking = open_folder(folder, problem, settings)
    done = sum(settings.size(index) for index in range(settings.chunks)) - sum(map(settings.size, lacking))
    wall, cpu = time.monotonic(), _cpu_seconds()
    bar = tqdm(
        total=settings.trajectories, initial=done, desc="solving", unit="trajectory", disable=None if progress else True
    )
    with bar:
        for index in _finished(problem, settings, folder, lacking, min(workers, max(1, len(lacking)))):
            bar.update(settings.size(index))
    return load_data(folder, problem), time.monotonic() - wall, _cpu_seconds() - cpu


def _finished(
    problem: Problem, settings: DataSettings, folder: Path, lacking: list[int], workers: int
) -> Iterator[int]:
    """Make the chunks and yield each one's index once its file is there."""
    if not lacking:
        return
    if workers == 1:
        solver = ChunkSolver(problem, settings)
        for index in lacking:
            write_chunk(folder, index, solver.solve(index))
            yield index
        return
    # Spawned: a forked copy of threads and of CasADi's state is no safe place to solve in.
    context = multiprocessing.get_context("spawn")
    terms = (problem.task, problem.form, problem.clearance, settings)
    with ProcessPoolExecutor(workers, context, _prepare, terms) as pool:
        with _workers_deaf_to_interrupts():
            waiting: set[Future[int]] = {pool.submit(_make, folder, index) for index in lacking}
        try:
            while waiting:
                finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in finished)
        except BrokenProcessPool:
            raise OcError(
                "a worker process was killed: run the same command again, it goes on where this ended"
            ) from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _workers_deaf_to_interrupts() -> Iterator[None]:
    """Let processes that start meanwhile inherit that SIGINT is ignored: Ctrl-C is for this one, it ends the others."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for_any([parent.sentinel])
        os._exit(1)


def _prepare(task: NavigationTask, form: Form, clearance: float, settings: DataSettings) -> None:
    global _solver
    # A worker whose parent was killed must not go on writing into a folder that the next run takes up.
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _solver = ChunkSolver(formulate(task, form, clearance), settings)


def _make(folder: Path, index: int) -> int:
    write_chunk(folder, index, _solver.solve(index))
    return index


def _cpu_seconds() -> float:
    """Return CPU seconds of this process and of those it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
