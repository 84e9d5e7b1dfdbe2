"""Many runs, as many at a time as there are cores; may be cut off at any time.

results = train_all(runs, Options(Path("runs/mine")))
"""

from __future__ import annotations

import fcntl
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from queue import Empty
from typing import Any

from tqdm import tqdm

from ctrl_rl_training.errors import TrainingError
from ctrl_rl_training.training import Options, Run, result_file, train_one

_LOOK_EVERY = 1.0


def train_all(runs: Sequence[Run], options: Options, workers: int = 0, title: str = "training") -> list[dict[str, Any]]:
    """Run what is not finished yet and return the results of all, see `train_one`.

    After a kill the same call goes on: it loses at most the iteration that each worker was in.

    Args:
        runs: in the order in which they begin.
        options: of all; `report` is not called.
        workers: runs at a time; 0 for one for each core.
        title: of the progress bar, and of the lock that keeps a second call with it out of the folder.

    Raises:
        TrainingError: another call works in the folder, or a worker was killed.
        CtrlRlError: a run refuses.
    """
    todo = [run for run in runs if not result_file(options.folder, run).is_file()]
    options.folder.mkdir(parents=True, exist_ok=True)
    with _alone(options.folder / f".{title}.lock"):
        if todo:
            _run(todo, options, min(len(todo), workers or os.cpu_count() or 1), title)
    return [train_one(run, options) for run in runs]


def _run(todo: Sequence[Run], options: Options, workers: int, title: str) -> None:
    context = multiprocessing.get_context("spawn")
    reports: Any = context.Queue()
    pool = ProcessPoolExecutor(workers, context, _begin_worker, (reports,))
    bar = tqdm(total=len(todo) * options.iterations, desc=title, unit="iteration", mininterval=5.0)
    try:
        waiting: set[Future[None]] = {pool.submit(_train, run, _picklable(options)) for run in todo}
        while waiting:
            done, waiting = wait(waiting, _LOOK_EVERY, FIRST_COMPLETED)
            _show(bar, reports)
            for future in done:
                future.result()
        _show(bar, reports)
    except BrokenProcessPool:
        raise TrainingError("a worker was killed: run the same command again to go on") from None
    finally:
        bar.close()
        pool.shutdown(wait=False, cancel_futures=True)


def _picklable(options: Options) -> dict[str, Any]:
    """Return the options without their report, which is a function of this process."""
    names = ("folder", "iterations", "samples", "evaluations", "final_evaluations")
    return {name: getattr(options, name) for name in names}


def _show(bar: tqdm[Any], reports: Any) -> None:
    while True:
        try:
            name, done, success = reports.get_nowait()
        except Empty:
            return
        bar.update(min(1, int(bar.total or 0) - bar.n))
        bar.set_postfix_str(f"{name} {done}: {100 * success:.0f} %")


_worker: dict[str, Any] = {}


def _begin_worker(reports: Any) -> None:
    _worker["reports"] = reports


def _train(run: Run, options: dict[str, Any]) -> None:
    def report(run: Run, done: int, success: float) -> None:
        _worker["reports"].put((run.name, done, success))

    train_one(run, Options(**options, report=report))


@contextmanager
def _alone(lock: Path) -> Iterator[None]:
    with lock.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise TrainingError(f"{lock.parent}: another run of this task is at work there") from None
        yield
