"""Parallel training runs in processes or on a Ray cluster, interruptible at any time.

results = run_experiments(runs, RunOptions(Path("runs/mine"), 10, 10240))
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import Empty
from typing import Any

from ctrl_rl_core.processes import CONTEXT, Tell, map_in_ray, require_ray
from tqdm import tqdm

from ctrl_rl_core import exclusive_lock, map_in_processes
from ctrl_rl_learning.study.run import Run, RunOptions, result_file
from ctrl_rl_learning.study.trainer import train


def run_experiments(
    runs: Sequence[Run], options: RunOptions, workers: int = 0, title: str = "training", ray: str | None = None
) -> list[dict[str, Any]]:
    """Run the unfinished runs and return the results of all.

    After an interruption the same call resumes and loses at most one iteration per worker.

    Args:
        runs: Runs in the order in which they start.
        options: Settings that all runs share.
        workers: Number of parallel runs; 0 for one per core, on this machine or in the cluster.
        title: Title of the progress bar, and name of the lock that keeps other calls out of the folder.
        ray: Address of a Ray cluster to train on, or "auto" for this machine's; local processes by default.

    Raises:
        LockError: Another call is using the folder.
        CtrlRlError: A run fails, or a worker was killed.
    """
    if ray is not None:
        require_ray()
    # Read finished runs first, so that a mismatch fails now and not after hours of training.
    known = {run.name: train(run, options) for run in runs if result_file(options.folder, run).is_file()}
    todo = [run for run in runs if run.name not in known]
    options.folder.mkdir(parents=True, exist_ok=True)
    with exclusive_lock(options.folder / f".{title}.lock"):
        if todo:
            with tqdm(total=len(todo) * options.iterations, desc=title, unit="iteration", mininterval=5.0) as bar:
                show = _Progress(bar)
                if ray is None:
                    _in_processes(todo, options, workers, show)
                else:
                    work = partial(_train_there, options=options)
                    for _ in map_in_ray(ray, work, todo, options.folder, lambda run: run.name, workers, show):
                        pass
        known |= {run.name: train(run, options) for run in todo}
    return [known[run.name] for run in runs]


class _Progress:
    """Progress bar that shows each run's name, its finished iterations, and a success rate or a message."""

    def __init__(self, bar: tqdm[Any]) -> None:
        self._bar = bar
        self._done: dict[str, int] = {}

    def __call__(self, report: tuple[str, int, float | str]) -> None:
        name, done, how = report
        before, left = self._done.get(name, 0), int(self._bar.total or 0) - self._bar.n
        new = min(max(done - before, 0), left)
        if name not in self._done and done > 1:  # resumed from a checkpoint: exclude earlier iterations from the pace
            self._bar.initial += new
            self._bar.last_print_n += new
            self._bar.n += new
        else:
            self._bar.update(new)
        self._done[name] = done
        self._bar.set_postfix_str(f"{name} {done}: {how if isinstance(how, str) else f'{100 * how:.0f} %'}")


def _in_processes(todo: Sequence[Run], options: RunOptions, workers: int, show: _Progress) -> None:
    reports: Any = CONTEXT.Queue()

    def show_all() -> None:
        for report in _waiting(reports):
            show(report)

    for _ in map_in_processes(partial(_train, options=options), todo, workers, _begin_worker, (reports,), show_all):
        show_all()


def _waiting(reports: Any) -> Iterator[Any]:
    while True:
        try:
            yield reports.get_nowait()
        except Empty:
            return


_worker: dict[str, Any] = {}


def _begin_worker(reports: Any) -> None:
    _worker["reports"] = reports


def _train(run: Run, options: RunOptions) -> None:
    train(run, options, lambda run, done, how: _worker["reports"].put((run.name, done, how)))


def _train_there(run: Run, folder: Path, tell: Tell, options: RunOptions) -> None:
    train(run, replace(options, folder=folder), lambda run, done, how: tell((run.name, done, how)))
