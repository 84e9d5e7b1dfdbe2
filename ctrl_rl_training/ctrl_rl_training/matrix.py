"""Many runs, as many at a time as there are cores; may be cut off at any time.

results = train_all(runs, Options(Path("runs/mine")))
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial
from queue import Empty
from typing import Any

from ctrl_rl_core.lock import alone
from ctrl_rl_core.workers import CONTEXT, in_processes
from tqdm import tqdm

from ctrl_rl_training.training import Options, Run, result_file, train_one


def train_all(runs: Sequence[Run], options: Options, workers: int = 0, title: str = "training") -> list[dict[str, Any]]:
    """Run what is not finished yet and return the results of all, see `train_one`.

    After a kill the same call goes on: it loses at most the iteration that each worker was in.

    Args:
        runs: in the order in which they begin.
        options: of all.
        workers: runs at a time; 0 for one for each core.
        title: of the progress bar, and of the lock that keeps a second call with it out of the folder.

    Raises:
        LockError: another call works in the folder.
        CtrlRlError: a run refuses, or a worker was killed.
    """
    todo = [run for run in runs if not result_file(options.folder, run).is_file()]
    options.folder.mkdir(parents=True, exist_ok=True)
    with alone(options.folder / f".{title}.lock"):
        if todo:
            _run(todo, options, min(len(todo), workers or os.cpu_count() or 1), title)
    return [train_one(run, options) for run in runs]


def _run(todo: Sequence[Run], options: Options, workers: int, title: str) -> None:
    reports: Any = CONTEXT.Queue()
    with tqdm(total=len(todo) * options.iterations, desc=title, unit="iteration", mininterval=5.0) as bar:
        work, show = partial(_train, options=options), partial(_show, bar, reports)
        for _ in in_processes(work, todo, workers, _begin_worker, (reports,), show):
            show()


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


def _train(run: Run, options: Options) -> None:
    def report(run: Run, done: int, success: float) -> None:
        _worker["reports"].put((run.name, done, success))

    train_one(run, options, report)
