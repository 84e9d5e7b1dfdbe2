"""The command `transfer`: how policies fare in the engine that they were not learnt in, and in other conditions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from ctrl_rl_core.command import CommandError, OptionalFileToWrite, at_least
from ctrl_rl_core.policies.policy import shipped_policies

from ctrl_rl_bringup.cli.running import run_here
from ctrl_rl_bringup.transfer.table import SHIFTS, Cell, drive_cells, transfer_ratios
from ctrl_rl_core import find_policy, load_navigation_task, load_policy, parse_options, write_results

_HOME = "pybullet"
_CORRIDOR = "curved_corridor"


@dataclass(frozen=True)
class TransferOptions:
    """Drive policies in both physics engines, nominal and shifted, and count how often they reach the goal."""

    policies: Annotated[tuple[str, ...], tyro.conf.arg(metavar="POLICY...")] = ()
    """Policies of the corridor: names or files; all that are shipped unless given."""

    task: str = _CORRIDOR
    """Task name or .yaml file."""

    engines: tuple[Literal["pybullet", "mujoco"], ...] = ("pybullet", "mujoco")
    """Engines to drive in."""

    shifts: Annotated[tuple[str, ...], tyro.conf.arg(metavar="SHIFT...")] = tuple(SHIFTS)
    """Conditions to drive in."""

    seeds: at_least(1) = 20  # type: ignore[valid-type]
    """Number of drives of each, with seeds from 0."""

    least_ratio: float = 0.0
    """Exit with 1 where less than this part of the success in PyBullet is left in the other engine, nominal."""

    results: OptionalFileToWrite = None
    """JSON file to write the metrics to."""


def transfer() -> int:
    """Drive policies in both physics engines, nominal and shifted."""
    options = parse_options("transfer", TransferOptions)
    return run_here("transfer", lambda: _transfer(options))


def _transfer(options: TransferOptions) -> int:
    for shift in options.shifts:
        if shift not in SHIFTS:
            raise CommandError(f"--shifts '{shift}': there are {', '.join(SHIFTS)}")
    task = load_navigation_task(options.task)
    names = options.policies or tuple(name for name in shipped_policies() if name.startswith(_CORRIDOR))
    policies = {Path(name).stem: (load_policy(find_policy(name)), task) for name in names}
    robot = "planar_quadrotor" if task.plane == "xz" else "differential_drive"
    for name, (policy, _) in policies.items():
        if policy.robot != robot:
            raise CommandError(f"policy {name} is for a {policy.robot}, task '{task.name}' has a {robot}")
    seeds = range(options.seeds)
    cells: list[Cell] = []
    for cell in drive_cells(policies, options.engines, options.shifts, seeds):
        print(cell.text(), flush=True)
        cells.append(cell)
        if options.results:  # after each, so that an end before the last loses little
            write_results(options.results, "transfer", list(seeds), [row for each in cells for row in each.results()])
    ratios = transfer_ratios(cells, _HOME)
    for name, ratio in ratios.items():
        print(f"{name}: {ratio:.3f} of its success in {_HOME}")
    return 1 if any(ratio < options.least_ratio for ratio in ratios.values()) else 0
