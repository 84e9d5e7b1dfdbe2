"""Drive every robot through doors with the filter and without, and print a line each."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from ctrl_rl_core.command import EXIT_USAGE
from ctrl_rl_safety.filter import least_passage
from tqdm import tqdm

from ctrl_rl_core import Result, parse_options, write_results
from ctrl_rl_safety import SafetyFilter
from doors.drives import MODELS, OPTIONS, SCAN_INTERVAL, Passage, draw_approach, pass_door

SPARE = (0.02, 0.1)
"""Least and most width of a door beyond what the certificate needs at the driver's speed [m]."""


@dataclass
class Options:
    """Drive filtered robots through doors 2 cm and more wider than the certificate needs; 1 if one is stuck."""

    episodes: int = 50
    """Number of doors of each robot."""
    seed: int = 0
    """Seed of the first door; the others follow it."""
    robots: tuple[str, ...] = tuple(MODELS)
    """Names of the robots."""
    output: Path | None = None
    """JSON file for the results."""


@dataclass(frozen=True)
class Pair:
    """The drives through one door with the filter and without."""

    filtered: Passage
    bare: Passage

    @property
    def stuck(self) -> bool:
        """Whether the filter keeps the robot from a door through which its driver brings it."""
        return self.bare.passed and not self.filtered.passed

    @property
    def ratio(self) -> float:
        """Time with the filter relative to that without; NaN where the driver alone hits a post."""
        return self.filtered.seconds / self.bare.seconds if self.bare.passed else math.nan


def main() -> int:
    """Drive; 0 where no robot is stuck and none touches anything behind the filter, else 1."""
    options = parse_options("doors", Options)
    unknown = [name for name in options.robots if name not in MODELS]
    if unknown or min(options.episodes, options.seed + 1) < 1:
        wrong = f"no robot {unknown[0]}: there are {', '.join(MODELS)}" if unknown else "--episodes: 1 or more"
        print(f"doors: {wrong}; --seed: 0 or more", file=sys.stderr)
        return EXIT_USAGE
    seeds = range(options.seed, options.seed + options.episodes)
    pairs: dict[str, list[Pair]] = {name: [] for name in options.robots}
    with tqdm(total=len(seeds) * len(pairs), desc="doors", unit=" doors", disable=None) as bar:
        for robot in options.robots:
            for seed in seeds:
                pairs[robot].append(drive_pair(robot, seed))
                bar.update()
    print(table(pairs))
    if options.output is not None:
        rows = [row for robot, each in pairs.items() for row in rows_of(robot, each)]
        write_results(options.output, "Through doors off their middle, behind the safety filter", list(seeds), rows)
    return int(any(each.stuck or each.filtered.contact for all_ in pairs.values() for each in all_))


def drive_pair(robot: str, seed: int) -> Pair:
    """Drive through the door of a seed with the filter and without; every second filter has recoverable sets."""
    model = MODELS[robot]
    width_at = partial(least_passage, model, options=OPTIONS, scan_interval=SCAN_INTERVAL)
    approach = draw_approach(model, seed, width_at, SPARE)
    filtered = pass_door(model, approach, seed, SafetyFilter(model, OPTIONS), with_set=seed % 2 == 0)
    return Pair(filtered, pass_door(model, approach, seed, None, with_set=False))


def table(pairs: dict[str, list[Pair]]) -> str:
    """Return a line a robot."""
    heads = f"{'doors':>6}{'stuck':>6}{'contacts':>9}{'without filter':>15}"
    heads += f"{'time over unfiltered: median':>29}{'largest':>9}"
    lines = [f"{'robot':<20}{heads}"]
    for robot, each in pairs.items():
        ratios = ratios_of(each) or [math.nan]
        counts = f"{len(each):>6}{sum(one.stuck for one in each):>6}{sum(one.filtered.contact for one in each):>9}"
        counts += f"{sum(one.bare.contact for one in each):>15}"
        lines.append(f"{robot:<20}{counts}{np.median(ratios):>29.3f}{max(ratios):>9.3f}")
    return "\n".join(lines)


def ratios_of(pairs: Sequence[Pair]) -> list[float]:
    """Return the times with the filter relative to those without, of the doors that the driver alone passes."""
    return [each.ratio for each in pairs if each.bare.passed]


def rows_of(robot: str, pairs: Sequence[Pair]) -> list[Result]:
    """Return the results of a robot as data, one value a door; times of the doors that the driver alone passes."""
    return [
        Result(robot, "stuck", "1", [float(each.stuck) for each in pairs]),
        Result(robot, "contacts", "1", [float(each.filtered.contact) for each in pairs]),
        Result(robot, "contacts without filter", "1", [float(each.bare.contact) for each in pairs]),
        Result(robot, "time over unfiltered", "1", [round(each, 4) for each in ratios_of(pairs)]),
    ]
