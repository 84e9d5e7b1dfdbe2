"""The command `trials`: counts contacts in episodes with and without the filter."""

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
"""Scan rates that are compatible with the filter's ticks and the steps of each engine [Hz]."""


@dataclass(frozen=True)
class Options:
    """Drive a simulated robot with adversaries and policies, with and without the safety filter, and count contacts.

    A contact is avoidable if the robot moves or touches a static object. A mover running into a stationary robot is
    counted separately. In flight tasks, the filter is the guard of planar quadrotors, which knows walls and obstacles,
    and a tilt beyond the limit counts as a contact. Exits with 1 if a robot behind the filter had an avoidable contact.
    """

    sources: tuple[str, ...] = ADVERSARIES
    """Adversaries (full_speed, random, and attacker, which was trained to cause contacts), and policies: names of
    shipped ones, files, or POLICY@TASK for another task; full_speed@TASK and random@TASK drive in a task as well."""
    episodes: Positive = 84
    """Number of episodes per source, place, robot and guard."""
    seed: NotNegative = 0
    """Seed of the first episode; the others are consecutive."""
    guards: Annotated[tuple[str, ...], some_of(GUARDS)] = ("none", "filter")
    """Guard between source and robot: nothing, the filter, the filter with the map, the filter with a robot that has 10
    % less braking and 30 ms more delay, or a quadrotor that is 3 % heavier, than assumed (mismatch), the filter with
    the engine's own wheels and a known command delay of 0.7 s (late), or nothing and no movers (alone)."""
    places: Annotated[tuple[str, ...], some_of(PLACES)] = PLACES
    """Rooms for adversaries: static boxes, optionally with two movers of up to 0.4 m/s."""
    robots: Annotated[tuple[str, ...], some_of(_ROBOTS)] = _ROBOTS
    """Robots for adversaries."""
    engine: Literal["planar", "pybullet", "mujoco"] = "planar"
    """Physics engine."""
    scan_rate: ScanRate = 0
    """Scans per second in tasks of policies for wheeled robots: 5, 10 or 20; 0 for the task's own. The decision rate of
    a policy is unchanged."""
    movers: NotNegative = 0
    """Number of additional movers of up to 0.4 m/s that wander in the tasks of policies for wheeled robots."""
    folder: FolderToWrite = Path("runs/safety_filter")
    """Folder for the episodes, from which interrupted trials are resumed."""
    results: OptionalFileToWrite = None
    """JSON file for the results; existing rows of other methods are kept."""


def cells_of(options: Options) -> list[Cell]:
    """Return the trial conditions, grouped by source.

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
    """Create the runner of a condition's episodes; `scan_rate` [Hz] and `movers` apply to policies of wheeled robots.

    Raises:
        CtrlRlError: Source, task, robot and guard are incompatible.
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
    """Return the result rows of a condition; the time lost is measured in pairs of one seed that both reach the goal.

    Args:
        method: Name of the condition.
        outcomes: Episodes of the condition.
        bare: Episodes of the same seeds without a filter.
        alone: Episodes of the same seeds without a filter and without movers.
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
    """Describe the differences to the tasks themselves."""
    rate = f", {options.scan_rate} scans a second" if options.scan_rate else ""
    return rate + (f", {options.movers} movers" if options.movers else "")


def _finished(cell: Cell, options: Options, bar: tqdm[Any]) -> list[TrialOutcome]:
    """Return the outcomes of a condition, after running missing episodes."""
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
        for cell in sorted(cells, key=lambda each: each.guard not in UNGUARDED):  # reference of the time lost
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
