"""Every algorithm with every reward from every seed, as many at a time as there are cores; may be cut off at any time.

run_matrix(MatrixOptions("car_ttr", Path("runs/ttr_learning"), value=Path("car_ttr.safetensors")))
"""

from __future__ import annotations

import fcntl
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty
from typing import Any

from tqdm import tqdm

from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.training import ITERATION, Cell, Options, result_file, train_one
from ttr_reward_node.training_algorithms import ALGORITHMS
from ttr_reward_node.value_file import load_value

REWARD_ORDER = ("ttr", "sparse", "distance_10", "distance_1", "distance_0.1", "distance_0")
"""What is learnt first if time should run out."""
_LOOK_EVERY = 1.0


def ordered(rewards: Sequence[str]) -> list[str]:
    """Return rewards in the order in which they are learnt."""
    return sorted(rewards, key=REWARD_ORDER.index)


@dataclass(frozen=True)
class MatrixOptions:
    """What to run.

    Attributes:
        task: of the runs.
        folder: where each has a folder of its own; finished ones are not run again.
        value: file of the task's time to reach; needed for the reward "ttr" alone.
        algorithms: in the order in which they run.
        rewards: the same, and before the algorithms.
        seeds: how many of each.
        iterations: of each run.
        samples: of an iteration.
        workers: runs at a time; 0 for one for each core.
    """

    task: str
    folder: Path
    value: Path | None = None
    algorithms: Sequence[str] = ALGORITHMS
    rewards: Sequence[str] = REWARD_ORDER
    seeds: int = 5
    iterations: int = 20
    samples: int = ITERATION
    workers: int = 0


def cells(options: MatrixOptions) -> list[Cell]:
    """Return the runs, in their order."""
    return [
        Cell(options.task, algorithm, reward, seed)
        for reward in options.rewards
        for seed in range(options.seeds)
        for algorithm in options.algorithms
    ]


def run_matrix(options: MatrixOptions) -> list[dict[str, Any]]:
    """Run what is not finished yet and return the results of all, see `train_one`.

    After a kill the same call goes on: it loses at most the iteration that each worker was in.

    Raises:
        TimeToReachError: another call works in the folder, a worker was killed, or a run refuses.
    """
    todo = [cell for cell in cells(options) if not result_file(options.folder, cell).is_file()]
    options.folder.mkdir(parents=True, exist_ok=True)
    with _alone(options.folder / f".{options.task}.lock"):
        if todo:
            _run(options, todo)
    return [train_one(cell, Options(options.folder)) for cell in cells(options)]


def _run(options: MatrixOptions, todo: Sequence[Cell]) -> None:
    context = multiprocessing.get_context("spawn")
    reports: Any = context.Queue()
    workers = min(len(todo), options.workers or os.cpu_count() or 1)
    pool = ProcessPoolExecutor(workers, context, _begin_worker, (options, reports))
    bar = tqdm(total=len(todo) * options.iterations, desc=options.task, unit="iteration", mininterval=5.0)
    try:
        waiting: set[Future[None]] = {pool.submit(_run_cell, cell) for cell in todo}
        while waiting:
            done, waiting = wait(waiting, _LOOK_EVERY, FIRST_COMPLETED)
            _show(bar, reports)
            for future in done:
                future.result()
        _show(bar, reports)
    except BrokenProcessPool:
        raise TimeToReachError("a worker was killed: run the same command again to go on") from None
    finally:
        bar.close()
        pool.shutdown(wait=False, cancel_futures=True)


def _show(bar: tqdm[Any], reports: Any) -> None:
    while True:
        try:
            cell, done, success = reports.get_nowait()
        except Empty:
            return
        bar.update(min(1, int(bar.total or 0) - bar.n))
        bar.set_postfix_str(f"{cell} {done}: {100 * success:.0f} %")


_worker: dict[str, Any] = {}


def _begin_worker(options: MatrixOptions, reports: Any) -> None:
    value = None if options.value is None else load_value(options.value)
    _worker["reports"] = reports
    _worker["options"] = Options(options.folder, value, options.iterations, options.samples)


def _run_cell(cell: Cell) -> None:
    reports = _worker["reports"]
    options = replace(_worker["options"], report=lambda *report: reports.put(report))
    train_one(cell, options)


@contextmanager
def _alone(lock: Path) -> Iterator[None]:
    with lock.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise TimeToReachError(f"{lock.parent}: another run of this task is at work there") from None
        yield
