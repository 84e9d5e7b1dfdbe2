"""The command `barn`: run the suite's controllers on the published worlds of BARN and DynaBARN."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
import yaml
from ctrl_rl_core.command import CommandError, NotNegative, OptionalFileToWrite, make_command
from tqdm import tqdm

from ctrl_rl_core import atomic_write, exclusive_lock, map_in_processes
from ctrl_rl_trials.barn.controllers import CONTROLLERS
from ctrl_rl_trials.barn.plan import PlannedDrive, make
from ctrl_rl_trials.barn.scenarios import MOVING, STATIC, Scenario, load_scenario
from ctrl_rl_trials.barn.table import BarnTable
from sim_bridge import SimulationOptions

_WORLDS = {
    "challenge": range(0, STATIC, 6),
    "barn": range(STATIC),
    "dynabarn": range(STATIC, STATIC + MOVING),
}


@dataclass(frozen=True)
class BarnOptions:
    """Drive a Jackal through the worlds of the BARN challenge, and compute the challenge's score.

    The worlds come from a checkout of github.com/Daffan/the-barn-challenge, which is not part of this suite. The
    command skips drives that the results file already has.
    """

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the checkout."""

    worlds: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WORLD...")] = ("challenge",)
    """Numbers or ranges (0-299 BARN, 300-359 DynaBARN), or challenge (every sixth BARN world), barn, dynabarn."""

    controllers: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...")] = ("explorer", "dynamic_window")
    """Controllers: explorer, navigator (has the map), dynamic_window, or the policies curved_corridor, car_ttr ..."""

    filters: tuple[Literal["off", "on"], ...] = ("off",)
    """Without or with the safety filter after the controller, or both."""

    engine: Literal["planar", "pybullet", "mujoco"] = "planar"
    """Physics engine."""

    drift: float = 0.002
    """Standard deviation of odometry's relative errors; the challenge's odometry takes its heading from an IMU."""

    seed: NotNegative = 0
    """Seed of noise and drift, which differ between worlds."""

    workers: NotNegative = 0
    """Number of parallel drives; 0 for one per core."""

    results: OptionalFileToWrite = None
    """JSON file for the results; drives already in it are kept."""

    tasks: Path | None = None
    """Folder to write the worlds to as task files, instead of driving."""


def _barn(options: BarnOptions) -> int:
    if unknown := [name for name in options.controllers if name not in CONTROLLERS]:
        raise CommandError(f"--controllers {unknown[0]}: there are {', '.join(CONTROLLERS)}")
    if not 0.0 <= options.drift <= 0.5:
        raise CommandError(f"--drift {options.drift}: must be 0 to 0.5")
    numbers = list(dict.fromkeys(number for word in options.worlds for number in _numbers(word)))
    if options.tasks is not None:
        return _write_tasks(options.folder, numbers, options.tasks)
    if options.results is None:
        return _drive(options, numbers)
    with exclusive_lock(options.results.with_name(f".{options.results.name}.lock")):
        return _drive(options, numbers)


def _drive(options: BarnOptions, numbers: list[int]) -> int:
    """Drive in the worlds that the results file lacks, and print the table."""
    table = BarnTable(options.results, options.seed)
    settings = SimulationOptions(engine=options.engine, odom_drift=options.drift)
    todo = [
        PlannedDrive(options.folder, number, name, filtered == "on", options.seed, settings)
        for filtered in options.filters
        for name in options.controllers
        for number in numbers
    ]
    left = [plan for plan in todo if not table.has(plan.method, plan.world)]
    if len(left) < len(todo):
        print(f"{options.results} already has {len(todo) - len(left)} of {len(todo)} drives")
    with tqdm(total=len(left), unit="drive", disable=None) as bar:
        for plan, end in map_in_processes(make, left, options.workers):
            table.add(plan.method, end)
            bar.clear()
            print(f"{plan.method}, world {plan.world}: {end.end} after {end.seconds:.1f} s, score {end.score():.3f}")
            bar.update()
    print(table.text())
    return 0


def _numbers(word: str) -> range:
    """Return the world numbers that a word of --worlds stands for.

    Raises:
        CommandError: The word is no name, number or range of worlds.
    """
    if word in _WORLDS:
        return _WORLDS[word]
    first, dash, last = word.partition("-")
    if first.isdecimal() and (last.isdecimal() if dash else not last) and len(word) < 10:
        low, high = int(first), int(last or first)
        if low <= high < STATIC + MOVING:
            return range(low, high + 1)
    raise CommandError(
        f"--worlds {word}: give numbers from 0 to {STATIC + MOVING - 1}, ranges, or {', '.join(_WORLDS)}"
    )


def _write_tasks(folder: Path, numbers: list[int], target: Path) -> int:
    """Write worlds as task files."""
    for number in tqdm(numbers, unit="world", disable=None):
        scenario: Scenario = load_scenario(folder, number)
        text = yaml.safe_dump(scenario.content, sort_keys=False, width=120)
        atomic_write(target / f"{scenario.task.name}.yaml", text)
    print(f"{len(numbers)} tasks in {target}")
    return 0


barn = make_command("barn", BarnOptions, _barn)
