"""The command `trials`: episodes with and without the filter, counted."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from ctrl_rl_core.command import (
    FolderToWrite,
    NotNegative,
    OptionalFileToWrite,
    Positive,
    parse_options,
    run_command,
    some_of,
)
from ctrl_rl_core.io import OutcomeLog, add_results
from ctrl_rl_core.policies import shipped_policies
from tqdm import tqdm

from ctrl_rl_core import Result, load_navigation_task
from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.trials.episodes import ADVERSARIES, GUARDS, UNGUARDED, Cell, Player, TrialOutcome, task_of
from ctrl_rl_safety.trials.flights import FlightPlayer
from ctrl_rl_safety.trials.worlds import PLACES

_ROBOTS = ("turtlebot3_burger", "turtlebot2")
_EXPERIMENT = "safety_filter"
ScanRate = Literal[0, 5, 10, 20]
"""Rates that are whole numbers of the filter's ticks and of steps of each engine [Hz]."""


@dataclass(frozen=True)
class Options:
    """Drives a simulated robot by adversaries and by policies, with and without the safety filter, and counts contacts.

    A contact is avoidable where the robot moves, or touches something that stands. A mover that runs into a robot that
    stands is counted apart. In tasks that fly the filter is the guard of planar quadrotors, which knows walls and
    obstacles, and a tilt beyond the limit counts as a contact. Exits with 1 where a robot behind the filter had an
    avoidable one.
    """

    sources: tuple[str, ...] = ADVERSARIES
    """Adversaries (full_speed, random, and attacker, which has learnt to bring about contacts), and policies: names of
    shipped ones, files, or POLICY@TASK for another task; full_speed@TASK and random@TASK drive in a task, too."""
    episodes: Positive = 84
    """Number of episodes of each source, place, robot and guard."""
    seed: NotNegative = 0
    """Seed of the first episode; the others follow."""
    guards: Annotated[tuple[str, ...], some_of(GUARDS)] = ("none", "filter")
    """Between source and robot: nothing, the filter, the filter with the map, the filter before a robot with 10 % less
    braking and 30 ms more delay, or a quadrotor 3 % heavier, than it assumes (mismatch), the filter before the engine's
    own wheels whose commands come 0.7 s late, as it knows (late), or nothing where nobody moves (alone)."""
    places: Annotated[tuple[str, ...], some_of(PLACES)] = PLACES
    """Rooms of adversaries: boxes that stand, or also two movers of up to 0.4 m/s."""
    robots: Annotated[tuple[str, ...], some_of(_ROBOTS)] = _ROBOTS
    """Robots of adversaries."""
    engine: Literal["planar", "pybullet", "mujoco"] = "planar"
    """Physics engine."""
    scan_rate: ScanRate = 0
    """Scans per second in the tasks of policies on wheels: 5, 10 or 20; 0 for the task's own. A policy decides as often
    as it does there."""
    movers: NotNegative = 0
    """Number of movers of up to 0.4 m/s that wander in the tasks of policies on wheels, besides their own."""
    folder: FolderToWrite = Path("runs/safety_filter")
    """Folder that keeps the episodes: after an interruption trials go on where they were."""
    results: OptionalFileToWrite = None
    """JSON file for the results; rows of other methods that it has are kept."""


def cells_of(options: Options) -> list[Cell]:
    """Return the cells of trials, those of one source side by side.

    Raises:
        SafetyError: A source is unknown.
    """
    out = []
    for given in options.sources:
        source, _, task = given.partition("@")
        if source in ADVERSARIES and not task:
            places = [(place, robot) for place in options.places for robot in options.robots]
        else:
            if source == "attacker":
                raise SafetyError("the attacker has learnt in rooms: give it no task")
            if source not in (*ADVERSARIES, *shipped_policies()) and not Path(source).suffix:
                known = ", ".join((*ADVERSARIES, *shipped_policies()))
                raise SafetyError(f"no source '{source[:60]}': there are {known}, or give a policy's file")
            places = [(task or task_of(Path(source).stem), "")]
        out += [Cell(source, *place, guard) for place in places for guard in options.guards]
    return out


def player_of(cell: Cell, engine: str, scan_rate: float = 0.0, movers: int = 0) -> Player | FlightPlayer:
    """Return who plays the episodes of a cell; `scan_rate` [Hz] and `movers` are for policies of robots on wheels.

    Raises:
        CtrlRlError: Its source, task, robot or guard do not go together.
    """
    if cell.place not in PLACES and (task := load_navigation_task(cell.place)).plane == "xz":
        return FlightPlayer(cell, engine, task)
    return Player(cell, engine, scan_rate, movers)


def rows_of(
    method: str,
    outcomes: Sequence[TrialOutcome],
    bare: Sequence[TrialOutcome] = (),
    alone: Sequence[TrialOutcome] = (),
) -> list[Result]:
    """Return the rows of a cell; the time lost is that of pairs of one seed that both reach the goal.

    Args:
        method: Name of the cell.
        outcomes: Episodes of the cell.
        bare: Episodes of the same seeds without a filter.
        alone: Episodes of the same seeds without a filter and without anything that moves.
    """
    figures: dict[str, list[float]] = {
        "avoidable collisions": [float(each.avoidable) for each in outcomes],
        "run into while standing": [float(each.run_into) for each in outcomes],
        "commands changed": [each.changed for each in outcomes],
        "distance": [each.distance for each in outcomes],
    }
    if any(each.succeeded for each in (*outcomes, *bare)):
        figures["success"] = [float(each.succeeded) for each in outcomes]
        figures["time lost"] = _lost(outcomes, bare)
        figures["time lost to nobody there"] = _lost(outcomes, alone)
    return [Result(method, name, "m" if name == "distance" else "1", each) for name, each in figures.items() if each]


def _lost(outcomes: Sequence[TrialOutcome], others: Sequence[TrialOutcome]) -> list[float]:
    pairs = [(one, other) for one, other in zip(outcomes, others, strict=False) if one.succeeded and other.succeeded]
    return [one.seconds / other.seconds - 1.0 for one, other in pairs]


def _changes(options: Options) -> str:
    """Return in words what is not as in the tasks themselves."""
    rate = f", {options.scan_rate} scans a second" if options.scan_rate else ""
    return rate + (f", {options.movers} movers" if options.movers else "")


def _finished(cell: Cell, options: Options, bar: tqdm[Any]) -> list[TrialOutcome]:
    """Return the outcomes of a cell, and play what is missing."""
    player = player_of(cell, options.engine, options.scan_rate, options.movers)
    name = re.sub(r"\W+", "-", f"{cell.method}-{options.engine}{_changes(options)}")
    settings = {"cell": cell.method, "engine": options.engine, "seed": options.seed, "terms": player.terms}
    log = OutcomeLog(options.folder / f"{name}.jsonl", settings, TrialOutcome, SafetyError)
    bar.set_postfix_str(cell.method)
    bar.update(min(len(log.outcomes), options.episodes))
    for seed in range(options.seed + len(log.outcomes), options.seed + options.episodes):
        log.add(player.play(seed))
        bar.update()
    return log.outcomes[: options.episodes]


def _work(options: Options) -> int:
    cells = cells_of(options)
    outcomes: dict[Cell, list[TrialOutcome]] = {}
    suffix = ("" if options.engine == "planar" else f", {options.engine}") + _changes(options)
    with tqdm(total=len(cells) * options.episodes, unit="episode", disable=None) as bar:
        for cell in sorted(cells, key=lambda each: each.guard not in UNGUARDED):  # the time lost is counted from these
            outcomes[cell] = _finished(cell, options, bar)
            others = [outcomes.get(replace(cell, guard=each), []) for each in UNGUARDED if cell.guard not in UNGUARDED]
            rows = rows_of(cell.method + suffix, outcomes[cell], *others)
            with bar.external_write_mode():
                figures = ", ".join(f"{row.metric} {np.mean(row.values):.3f}" for row in rows)
                print(f"{cell.method}{suffix}: {figures}")
            if options.results is not None:
                add_results(options.results, _EXPERIMENT, [options.seed], rows)
    hit = sum(each.avoidable for cell, played in outcomes.items() for each in played if cell.guard not in UNGUARDED)
    print(f"{hit} avoidable collisions behind the filter")
    return 0 if hit == 0 else 1


def main() -> int:
    """Entry point of `ros2 run ctrl_rl_safety trials`."""
    options = parse_options("trials", Options)
    return run_command("trials", lambda: _work(options))
