"""The command `trials`: random drives on maps in the simulator, with counts and times."""

from __future__ import annotations

import hashlib
import math
import re
import sys
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
from ctrl_rl_core.command import parse_options, run_command
from ctrl_rl_core.io import OutcomeLog, add_results

from ctrl_rl_core import OccupancyMap, Result, find_robot
from ctrl_rl_navigation.cli.goals import GoalMaker
from ctrl_rl_navigation.cli.nodes import drive_through_nodes
from ctrl_rl_navigation.cli.outcome import Options, Outcome
from ctrl_rl_navigation.cli.simulation import DriveSimulation, Errors
from ctrl_rl_navigation.driving.decision import Goal, NavigatorOptions, NavigatorState
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.maps import map_file
from ctrl_rl_navigation.robot import limits_of

_LONGEST, _SPARE_S = 4.0, 30.0
"""Time limit of a drive: multiple of its best time, and additional time [s]."""
_NEAR_S = 3.0
"""Best time below which a drive is not timed [s], because accelerations are then a large part of it."""


def named_file(word: str) -> tuple[str, Path]:
    """Parse the name and file of a map from the command line.

    Raises:
        NavigationError: There is no such map, or the name is not valid as a file name.
    """
    name, equals, file = word.partition("=")
    if equals and not re.fullmatch(r"\w[\w.-]*", name):
        raise NavigationError(f"--maps {word}: the name before '=' must consist of letters, digits, '.', '_' and '-'")
    return (name, Path(file)) if equals else (Path(word).stem, map_file(word))


def drive_all(file: Path, map_: OccupancyMap, options: Options, engine: str, made: int) -> Iterator[Outcome]:
    """Yield the outcome of each trial on a map, except for the first ones, which are already done."""
    limits, tolerance = limits_of(find_robot(options.robot)), NavigatorOptions().tolerance
    errors = Errors(options.drift, options.position_error, math.radians(options.heading_error))
    maker = GoalMaker(map_, limits, tolerance)
    trials = maker.draw(np.random.default_rng((options.seed, 1)), options.goals)
    for number, trial in islice(enumerate(trials), made, None):
        best = maker.best_time(trial.start, trial.goal) if trial.reachable else math.inf
        simulation = DriveSimulation(file, trial.start, options.seed + number, errors, limits, engine, options.robot)
        try:
            begin = time.monotonic()
            longest = _LONGEST * (best if trial.reachable else 0.0) + _SPARE_S
            drive = simulation.drive(Goal(trial.goal), longest)
            told = drive.state is NavigatorState.UNREACHABLE and not trial.reachable
            yield Outcome(trial, drive, best, time.monotonic() - begin if told else math.nan)
        finally:
            simulation.close()


def rows_of(method: str, outcomes: list[Outcome]) -> list[Result]:
    """Return the result rows of a map and engine."""
    reachable = [each for each in outcomes if each.trial.reachable]
    others = [each for each in outcomes if not each.trial.reachable]
    timed = [each.drive.seconds / each.best for each in reachable if each.arrived and each.best >= _NEAR_S]
    rows = [
        Result(method, "arrived", "1", [float(each.arrived) for each in reachable]),
        Result(method, "collisions", "1", [float(each.drive.collided) for each in outcomes]),
        Result(method, "time over optimal", "1", timed),
        Result(method, "median time over optimal", "1", [float(np.median(timed))] if timed else []),
        Result(
            method,
            "unreachable said",
            "1",
            [float(each.drive.state is NavigatorState.UNREACHABLE) for each in others],
        ),
        Result(method, "time until unreachable is said", "s", [e.answered for e in others if e.answered >= 0.0]),
    ]
    return [row for row in rows if row.values]


def _say(name: str, number: int, goals: int, outcome: Outcome) -> None:
    drive = outcome.drive
    what = "collision" if drive.collided else drive.state.name.lower()
    best = f", best {outcome.best:.1f} s" if outcome.trial.reachable else ""
    text = f"{name} {number}/{goals}: {what} after {drive.seconds:.1f} s{best}, {drive.distance:.2f} m from the goal"
    print(text)


def _log(name: str, map_: OccupancyMap, options: Options, engine: str) -> OutcomeLog[Outcome]:
    """Return the log of earlier drives on a map."""
    errors = (options.drift, options.position_error, options.heading_error)
    cells = hashlib.sha256(map_.cells.tobytes() + repr((map_.resolution, map_.origin)).encode()).hexdigest()
    settings = {"map": cells, "seed": options.seed, "errors": list(errors), "engine": engine, "ros": options.ros}
    file = options.folder / f"{_method(name, options, engine).replace(', ', '-')}.jsonl"
    return OutcomeLog(file, settings, Outcome, NavigationError)


def _method(name: str, options: Options, engine: str) -> str:
    return f"{name}, {engine}{', nodes' if options.ros else ''}"


def _work(options: Options) -> int:
    files = [named_file(word) for word in options.maps]
    maps = [(name, file, OccupancyMap.load(file)) for name, file in files]
    if not all(math.isfinite(x) and x >= 0.0 for x in (options.drift, options.position_error, options.heading_error)):
        raise NavigationError("errors of pose and odometry must be finite and not negative")
    failed = 0
    for engine in options.engines:
        for name, file, map_ in maps:
            log = _log(name, map_, options, engine)
            drive = drive_through_nodes if options.ros else drive_all
            for outcome in drive(file, map_, options, engine, len(log.outcomes)):
                log.add(outcome)
                _say(name, len(log.outcomes), options.goals, outcome)
            outcomes = log.outcomes[: options.goals]
            found = rows_of(_method(name, options, engine), outcomes)
            if options.results is not None:
                add_results(options.results, "navigator", [options.seed], found)
            failed += sum(each.trial.reachable and not each.arrived for each in outcomes)
            print(f"{name}: " + ", ".join(f"{row.metric} {np.mean(row.values):.3f}" for row in found))
    return 0 if failed == 0 else 1


def main() -> int:
    """Entry point of `ros2 run ctrl_rl_navigation trials`."""
    options = parse_options("trials", Options)
    return run_command("trials", lambda: _work(options))


if __name__ == "__main__":
    sys.exit(main())
