"""The command `transfer`: tests policies in the engine they were not trained in, and under other conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro
from ctrl_rl_core.command import OptionalFileToWrite, at_least
from ctrl_rl_core.io import read_experiment, results_lock
from ctrl_rl_core.policies import policy_digest, shipped_policies
from tqdm import tqdm

from ctrl_rl_bringup.cli.running import run_here
from ctrl_rl_bringup.transfer.table import SHIFTS, Cell, Entry, drive_cells, plan_cells, transfer_ratios
from ctrl_rl_core import (
    CommandError,
    Result,
    find_policy,
    load_navigation_task,
    load_policy,
    parse_options,
    task_names,
    write_results,
)

_HOME = "pybullet"
_DIGESTS = "digests"
"""Key in the results' figures: digest of each cell."""


@dataclass(frozen=True)
class TransferOptions:
    """Drive policies in both physics engines, nominal and shifted, and count how often they reach the goal.

    Cells in the results file with the same policies, tasks, conditions and seeds are not driven again.
    """

    policies: Annotated[tuple[str, ...], tyro.conf.arg(metavar="POLICY...")] = ()
    """Names of shipped policies, files, or NAME=FOLDER for the policies of all runs in a folder of `train`; all that
    are shipped unless given."""

    task: str | None = None
    """Task name or .yaml file; that which a policy's name begins with unless given."""

    engines: tuple[Literal["pybullet", "mujoco"], ...] = ("pybullet", "mujoco")
    """Engines to drive in."""

    shifts: Annotated[tuple[str, ...], tyro.conf.arg(metavar="SHIFT...")] = tuple(SHIFTS)
    """Conditions to drive in; those that mean nothing for a robot are left out."""

    seeds: at_least(1) = 20  # type: ignore[valid-type]
    """Number of drives of each policy, with seeds from 0."""

    least_ratio: float = 0.0
    """Exit with 1 where less than this part of the success in PyBullet is left in the other engine, nominal."""

    results: OptionalFileToWrite = None
    """JSON file to write the metrics to; rows of other policies stay in it."""


def transfer() -> int:
    """Drive policies in both physics engines, nominal and shifted."""
    options = parse_options("transfer", TransferOptions)
    return run_here("transfer", lambda: _transfer(options))


def _transfer(options: TransferOptions) -> int:
    for shift in options.shifts:
        if shift not in SHIFTS:
            raise CommandError(f"--shifts '{shift}': there are {', '.join(SHIFTS)}")
    entries = [_read_entry(word, options.task) for word in options.policies or shipped_policies()]
    names = [entry.name for entry in entries]
    if len(set(names)) < len(names):
        raise CommandError("two policies have the same name: give NAME=FILE")
    seeds = range(options.seeds)
    table = _Table(options.results, seeds)
    cells, missing = [], []
    for entry, cell in plan_cells(entries, options.engines, options.shifts, seeds):
        known = table.known(cell)
        if known is None:
            missing.append((entry, cell))
        else:
            cells.append(known)
    if cells:
        print(f"{len(cells)} of {len(cells) + len(missing)} cells are in {options.results} already")
    with tqdm(total=sum(len(entry.policies) for entry, _ in missing) * len(seeds), unit="drive", disable=None) as bar:
        for cell in drive_cells(missing, seeds, bar.update):
            bar.clear()
            print(cell.text())
            cells.append(cell)
            table.add(cell)
    ratios = transfer_ratios(cells, _HOME)
    for name, ratio in ratios.items():
        print(f"{name}: {ratio:.3f} of its success in {_HOME}")
    return 1 if any(ratio < options.least_ratio for ratio in ratios.values()) else 0


def _read_entry(word: str, task_name: str | None) -> Entry:
    """Return the policies of an argument, with their task.

    Raises:
        CtrlRlError: There are none, the task is unknown, or it has another robot.
    """
    name, equals, place = word.partition("=")
    if equals:
        folder = Path(place).expanduser()
        files = sorted(folder.glob("*/policy.safetensors")) if folder.is_dir() else [folder]
        if not name or not files:
            raise CommandError(f"'{word}': give NAME=FOLDER, a folder with runs of `train` in it, or NAME=FILE")
    else:
        name, files = Path(word).stem, [find_policy(word)]
    own = max((task for task in task_names() if name.startswith(task)), key=len, default=None)
    if task_name is None and own is None:
        raise CommandError(f"policy '{name}' does not begin with the name of a task: give --task")
    task = load_navigation_task(task_name or str(own))
    robot = "planar_quadrotor" if task.plane == "xz" else "differential_drive"
    policies = {}
    for file in files:
        policy = load_policy(file)
        if policy.robot != robot:
            raise CommandError(f"policy {name} is for a {policy.robot}, task '{task.name}' has a {robot}")
        policies[policy_digest(file)] = policy
    return Entry(name if equals or own == task.name else f"{name} in {task.name}", task, policies)


class _Table:
    """The rows of a results file, by method, with the digest of each one's cell."""

    def __init__(self, file: Path | None, seeds: Sequence[int]) -> None:
        self._file, self._seeds = file, seeds
        self._rows: dict[tuple[str, str], Result] = {}
        self._digests: dict[str, str] = {}
        self._take()

    def _take(self) -> None:
        """Take the rows of the file that are not known yet: another command may add to it, too."""
        file = self._file
        there = read_experiment(file) if file is not None and file.exists() else None
        if there is None:
            return
        for row in there.rows:
            self._rows.setdefault((row.method, row.metric), Result(row.method, row.metric, row.unit, row.values))
        told = there.figures.get(_DIGESTS) if isinstance(there.figures, Mapping) else None
        self._digests = {**(told if isinstance(told, Mapping) else {}), **self._digests}

    def known(self, cell: Cell) -> Cell | None:
        """Return a cell with its figures, if it was driven before."""
        rows = [self._rows.get((cell.method, metric)) for metric in ("success", "collision")]
        if self._digests.get(cell.method) != cell.digest or rows[0] is None or rows[1] is None:
            return None
        return replace(cell, reached=rows[0].values, collided=rows[1].values)

    def add(self, cell: Cell) -> None:
        """Write a cell, after which an end of the command loses nothing."""
        self._rows |= {(cell.method, row.metric): row for row in cell.results()}
        self._digests[cell.method] = cell.digest
        if self._file is None:
            return
        with results_lock(self._file):
            self._take()
            digests = {_DIGESTS: self._digests}
            write_results(self._file, "transfer", self._seeds, list(self._rows.values()), digests)
