"""Send goals and follow paths, and print a line for each kind of goal and each driver."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ctrl_rl_core.command import EXIT_USAGE
from ctrl_rl_core.io import add_results
from tqdm import tqdm

from ctrl_rl_core import Result, parse_options
from nav_actions.drivers import DRIVERS
from nav_actions.drives import PathDrive, follow
from nav_actions.goals import KINDS, Sent, nodes, send
from nav_actions.paths import draw_trial

_TITLE = "Nav2's actions, and drivers along paths behind the safety filter"


@dataclass
class Options:
    """Count goals with the result that a client of Nav2 expects, and follow paths; 1 if a goal ends otherwise."""

    goals: int = 50
    """Number of goals through the real nodes; 0 for none."""
    paths: int = 50
    """Number of paths of each driver; 0 for none."""
    seed: int = 0
    """Seed of the first goal and path; the others follow it."""
    drivers: tuple[str, ...] = tuple(DRIVERS)
    """Names of the drivers."""
    speed: float = 2.0
    """Real-time factor of the simulator."""
    output: Path | None = None
    """JSON file for the results; rows of other methods are kept."""


def main() -> int:
    """Run; 0 if every goal ends as expected, else 1."""
    options = parse_options("nav_actions", Options)
    unknown = [name for name in options.drivers if name not in DRIVERS]
    if unknown or min(options.goals, options.paths, options.seed) < 0 or not 0.1 <= options.speed <= 10.0:
        wrong = f"no driver {unknown[0]}: there are {', '.join(DRIVERS)}" if unknown else "--goals, --paths: 0 or more"
        print(f"nav_actions: {wrong}; --seed: 0 or more; --speed: 0.1 to 10", file=sys.stderr)
        return EXIT_USAGE
    sent = send_goals(options) if options.goals else []
    if options.paths:
        follow_paths(options)
    return int(not all(each.as_expected for each in sent))


def send_goals(options: Options) -> list[Sent]:
    """Send the goals, print a line for each kind, and write the results."""
    seeds = range(options.seed, options.seed + options.goals)
    with tempfile.TemporaryDirectory(prefix="nav_actions_") as folder, nodes(Path(folder), options.speed) as client:
        sent = list[Sent]()
        for seed in seeds:
            sent.append(send(client, seed))
            fits = "as expected" if sent[-1].as_expected else "NOT as expected"
            print(f"{seed:>4} {sent[-1].kind:<12} {fits}, {sent[-1].seconds:.0f} s", flush=True)
    print(f"{'goal':<14}{'sent':>6}{'as expected':>13}")
    for kind in KINDS:
        fits = [each.as_expected for each in sent if each.kind == kind]
        if fits:
            print(f"{kind:<14}{len(fits):>6}{sum(fits):>13}")
    if options.output is not None:
        values = [float(each.as_expected) for each in sent]
        add_results(options.output, _TITLE, list(seeds), [Result("actions of the navigator", "goals", "1", values)])
    return sent


def follow_paths(options: Options) -> None:
    """Follow the paths by each driver, print a line a driver, and write the results."""
    seeds = range(options.seed, options.seed + options.paths)
    drives: dict[str, list[PathDrive]] = {name: [] for name in options.drivers}
    with (
        tempfile.TemporaryDirectory(prefix="nav_actions_") as folder,
        tqdm(total=len(seeds) * len(drives), desc="paths", unit=" drives", disable=None) as bar,
    ):
        for seed in seeds:
            trial = draw_trial(seed, Path(folder))
            for name, each in drives.items():
                each.append(follow(trial, DRIVERS[name](trial), seed))
                bar.update()
    print(f"{'driver':<20}{'paths':>6}{'arrived':>8}{'contacts':>9}{'time':>6}{'error':>8}{'largest [m]':>12}")
    for name, each in drives.items():
        print(line(name, each), flush=True)
        if options.output is not None:
            add_results(options.output, _TITLE, list(seeds), rows_of(name, each))


def line(name: str, drives: Sequence[PathDrive]) -> str:
    """Return the figures of a driver for people; times are those of arrivals."""
    times = [each.seconds for each in drives if each.arrived]
    counts = f"{len(drives):>6}{sum(each.arrived for each in drives):>8}{sum(each.contact for each in drives):>9}"
    errors = f"{np.mean([each.error for each in drives]):>8.3f}{max(each.largest_error for each in drives):>12.2f}"
    return f"{name:<20}{counts}{np.median(times) if times else np.nan:>6.2f}{errors}"


def rows_of(name: str, drives: Sequence[PathDrive]) -> list[Result]:
    """Return the results of a driver as data, one value a path."""
    return [
        Result(name, "arrived", "1", [float(each.arrived) for each in drives]),
        Result(name, "contacts", "1", [float(each.contact) for each in drives]),
        Result(name, "time over that at full speed", "1", [round(each.seconds, 3) for each in drives]),
        Result(name, "path error", "m", [round(each.error, 4) for each in drives]),
        Result(name, "largest path error", "m", [round(each.largest_error, 4) for each in drives]),
    ]
