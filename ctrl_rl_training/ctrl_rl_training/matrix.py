"""Many runs, as many at a time as there are cores; may be cut off at any time.

results = train_all(runs, Options(Path("runs/mine")))
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from queue import Empty
from typing import Any, Protocol

from ctrl_rl_core.lock import alone
from ctrl_rl_core.workers import CONTEXT, in_processes
from tqdm import tqdm

from ctrl_rl_training.run_folder import Named, Options, Report, result_file


class Train(Protocol):
    """One run from beginning to end, or on from where it was cut off, or read; importable by name."""

    def __call__(self, run: Any, options: Options, report: Report = ..., /) -> dict[str, Any]:
        """Return the result, see `ctrl_rl_training.training.train_one`."""


def percent(value: float) -> str:
    """Return a success rate as progress shows it."""
    return f"{100 * value:.0f} %"


def train_all(
    runs: Sequence[Named],
    options: Options,
    workers: int = 0,
    title: str = "training",
    train: Train | None = None,
    say: Callable[[float], str] = percent,
) -> list[dict[str, Any]]:
    """Run what is not finished yet and return the results of all, see `train_one`.

    After a kill the same call goes on: it loses at most the iteration that each worker was in.

    Args:
        runs: in the order in which they begin.
        options: of all.
        workers: runs at a time; 0 for one for each core.
        title: of the progress bar, and of the lock that keeps a second call with it out of the folder.
        train: what one run is; `train_one` unless given.
        say: how progress shows what a run reports.

    Raises:
        LockError: another call works in the folder.
        CtrlRlError: a run refuses, or a worker was killed.
    """
    if train is None:
        from ctrl_rl_training.training import train_one  # imports Stable-Baselines3, which takes seconds

        train = train_one
    todo = [run for run in runs if not result_file(options.folder, run).is_file()]
    options.folder.mkdir(parents=True, exist_ok=True)
    with alone(options.folder / f".{title}.lock"):
        if todo:
            _run(todo, options, min(len(todo), workers or os.cpu_count() or 1), title, train, say)
        return [train(run, options) for run in runs]


def _run(
    todo: Sequence[Named], options: Options, workers: int, title: str, train: Train, say: Callable[[float], str]
) -> None:
    reports: Any = CONTEXT.Queue()
    with tqdm(total=len(todo) * options.iterations, desc=title, unit="iteration", mininterval=5.0) as bar:
        work, show = partial(_train, options=options, train=train), partial(_show, bar, reports, say)
        for _ in in_processes(work, todo, workers, _begin_worker, (reports,), show):
            show()


def _show(bar: tqdm[Any], reports: Any, say: Callable[[float], str]) -> None:
    while True:
        try:
            name, done, value = reports.get_nowait()
        except Empty:
            return
        bar.update(min(1, int(bar.total or 0) - bar.n))
        bar.set_postfix_str(f"{name} {done}: {say(value)}")


_worker: dict[str, Any] = {}


def _begin_worker(reports: Any) -> None:
    _worker["reports"] = reports


def _train(run: Named, options: Options, train: Train) -> None:
    def report(run: Named, done: int, value: float) -> None:
        _worker["reports"].put((run.name, done, value))

    train(run, options, report)
