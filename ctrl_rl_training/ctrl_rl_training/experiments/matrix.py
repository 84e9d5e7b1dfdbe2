"""Many runs, as many at a time as there are cores; may be cut off at any time.

    results = train_all(runs, Options(Path("runs/mine")), train_one)

A run and how it learns are its own matter: the function that trains one is given.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import Empty
from typing import Any, Protocol, TypeVar

from ctrl_rl_core.processes.exclusive_lock import exclusive_lock
from ctrl_rl_core.processes.ray_workers import Tell, map_in_ray
from ctrl_rl_core.processes.workers import CONTEXT, map_in_processes
from tqdm import tqdm

from ctrl_rl_training.experiments.run_folder import Named, result_file


class HowRunsGo(Protocol):
    """How runs go, as far as it matters here."""

    @property
    def folder(self) -> Path:
        """Where each has a folder of its own."""

    @property
    def iterations(self) -> int:
        """How many reports each makes."""


AnyRun = TypeVar("AnyRun", bound=Named)
How = TypeVar("How", bound=HowRunsGo)
Report = Callable[[AnyRun, int, float | str], None]
"""What is told: the run, the iterations done, and a success rate or other words on how it goes. It may be told more
than once for an iteration, where something else takes long."""
Train = Callable[[AnyRun, How, Report[AnyRun]], dict[str, Any]]
"""Trains a run, or reads the result of a finished one, and reports each iteration."""


def train_all(
    runs: Sequence[AnyRun],
    options: How,
    train: Train[AnyRun, How],
    workers: int = 0,
    title: str = "training",
    ray: str | None = None,
) -> list[dict[str, Any]]:
    """Run what is not finished yet and return the results of all.

    After a kill the same call goes on: it loses at most the iteration that each worker was in.

    Args:
        runs: Runs in the order in which they begin.
        options: Settings that all runs share.
        train: Function that trains one run; a worker process imports it by name.
        workers: Runs at a time; 0 for one for each core, here or in the cluster.
        title: Title of the progress bar and name of the lock that keeps a second call out of the folder.
        ray: Address of a Ray cluster whose workers train, "auto" for this machine's; processes of this machine unless
            given.

    Raises:
        LockError: another call works in the folder.
        CtrlRlError: a run refuses, or a worker was killed.
    """
    # What is finished is read first: what does not fit is refused now, not after hours of the others.
    finished = [run for run in runs if result_file(options.folder, run).is_file()]
    known = {run.name: train(run, options, lambda *_: None) for run in finished}
    todo = [run for run in runs if run.name not in known]
    options.folder.mkdir(parents=True, exist_ok=True)
    with exclusive_lock(options.folder / f".{title}.lock"):
        if todo:
            with tqdm(total=len(todo) * options.iterations, desc=title, unit="iteration", mininterval=5.0) as bar:
                if ray is None:
                    _in_processes(todo, options, min(len(todo), workers or os.cpu_count() or 1), train, bar)
                else:
                    _in_ray(ray, todo, options, workers, train, bar)
        known |= {run.name: train(run, options, lambda *_: None) for run in todo}
    return [known[run.name] for run in runs]


def _in_processes(
    todo: Sequence[AnyRun], options: How, workers: int, train: Train[AnyRun, How], bar: tqdm[Any]
) -> None:
    reports: Any = CONTEXT.Queue()
    work, show = partial(_train, options=options, train=train), partial(_show, bar, reports, {})
    for _ in map_in_processes(work, todo, workers, _begin_worker, (reports,), show):
        show()


def _in_ray(
    address: str, todo: Sequence[AnyRun], options: How, workers: int, train: Train[AnyRun, How], bar: tqdm[Any]
) -> None:
    told: dict[str, int] = {}
    work = partial(_train_there, options=options, train=train)
    for _ in map_in_ray(
        address, work, todo, options.folder, lambda run: run.name, workers, lambda report: _note(bar, told, *report)
    ):
        pass


def _show(bar: tqdm[Any], reports: Any, told: dict[str, int]) -> None:
    """Show what was reported; `told` keeps the iterations of each run, and begins empty."""
    while True:
        try:
            report = reports.get_nowait()
        except Empty:
            return
        _note(bar, told, *report)


def _note(bar: tqdm[Any], told: dict[str, int], name: str, done: int, how: float | str) -> None:
    """Show one report."""
    if done > told.get(name, 0):
        bar.update(min(1, int(bar.total or 0) - bar.n))
    told[name] = done
    bar.set_postfix_str(f"{name} {done}: {how if isinstance(how, str) else f'{100 * how:.0f} %'}")


_worker: dict[str, Any] = {}


def _begin_worker(reports: Any) -> None:
    _worker["reports"] = reports


def _train(run: AnyRun, options: How, train: Train[AnyRun, How]) -> None:
    train(run, options, lambda run, done, how: _worker["reports"].put((run.name, done, how)))


def _train_there(run: AnyRun, folder: Path, tell: Tell, options: How, train: Train[AnyRun, How]) -> None:
    there = replace(options, folder=folder)  # type: ignore[type-var]
    train(run, there, lambda run, done, how: tell((run.name, done, how)))
