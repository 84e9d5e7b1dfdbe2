"""Drive every robot at every rate of missing, and print a line each."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ctrl_rl_core.command import EXIT_USAGE
from tqdm import tqdm

from ctrl_rl_core import Result, parse_options, write_results
from ctrl_rl_safety import ROBOTS
from missing_echoes.drives import Ride, ride

RATES = (0.0, 0.1, 0.2, 0.3)
"""Probabilities that a beam is lost, and that a whole scan is."""
_DEFAULT = 0.1
"""Rate that the filter assumes where nothing is lost, as robots' files do."""


@dataclass
class Options:
    """Count contacts of filtered robots with thin poles while the lidar loses beams; 1 if there is one."""

    episodes: int = 100
    """Number of episodes of each robot at each rate."""
    seed: int = 0
    """Seed of the first episode; the others follow it."""
    robots: tuple[str, ...] = tuple(ROBOTS)
    """Names of the robots."""
    output: Path | None = None
    """JSON file for the results."""


@dataclass(frozen=True)
class Condition:
    """One robot, the share of beams that is lost, and whether the filter knows it or trusts each scan alone."""

    robot: str
    lost: float
    known: bool

    @property
    def method(self) -> str:
        """Name in results."""
        return f"{self.robot}, {self.lost:.0%} lost" + ("" if self.known else ", each scan trusted alone")

    @property
    def rate(self) -> float:
        """Rate of missing that the filter assumes."""
        return (self.lost or _DEFAULT) if self.known else 0.0


def main() -> int:
    """Drive; 0 where a filter that knows the rate of missing lets no contact happen, else 1."""
    options = parse_options("missing_echoes", Options)
    unknown = [name for name in options.robots if name not in ROBOTS]
    if unknown or min(options.episodes, options.seed + 1) < 1:
        wrong = f"no robot {unknown[0]}: there are {', '.join(ROBOTS)}" if unknown else "--episodes: 1 or more"
        print(f"missing_echoes: {wrong}; --seed: 0 or more", file=sys.stderr)
        return EXIT_USAGE
    seeds = range(options.seed, options.seed + options.episodes)
    conditions = [Condition(*each) for each in _conditions(options.robots)]
    bar = tqdm(total=len(seeds) * len(conditions), desc="missing_echoes", unit=" episodes", disable=None)
    rides: dict[Condition, list[Ride]] = {each: [] for each in conditions}
    with bar:
        for condition in conditions:
            for seed in seeds:
                rides[condition].append(ride(condition.robot, seed, condition.lost, condition.rate))
                bar.update()
    print(table(rides))
    if options.output is not None:
        write_results(options.output, "Rushing at thin poles while echoes go missing", list(seeds), rows(rides))
    return int(any(each.contact for condition, all_ in rides.items() if condition.known for each in all_))


def _conditions(robots: tuple[str, ...]) -> Iterator[tuple[str, float, bool]]:
    for robot in robots:
        for lost in RATES:
            yield from ((robot, lost, True), (robot, lost, False))


def table(rides: dict[Condition, list[Ride]]) -> str:
    """Return a line a condition."""
    lines = [f"{'condition':<58}{'episodes':>9}{'contacts':>9}{'least room [m]':>15}{'time lost':>10}"]
    for condition, each in rides.items():
        lost = f"{lost_time(rides, condition):.1f} %" if condition.known and not condition.lost else ""
        contacts, least = sum(one.contact for one in each), min(one.clearance for one in each)
        lines.append(f"{condition.method:<58}{len(each):>9}{contacts:>9}{least:>15.3f}{lost:>10}")
    return "\n".join(lines)


def lost_time(rides: dict[Condition, list[Ride]], condition: Condition) -> float:
    """Return by how much less the robot gets on in the same time than where each scan is trusted alone [%]."""
    alone = rides[Condition(condition.robot, condition.lost, False)]
    return 100.0 * (1.0 - sum(each.distance for each in rides[condition]) / sum(each.distance for each in alone))


def rows(rides: dict[Condition, list[Ride]]) -> list[Result]:
    """Return the results as data: contacts of each episode, and the time lost where nothing is missing."""
    out = []
    for condition, each in rides.items():
        out.append(Result(condition.method, "contacts", "1", [float(one.contact) for one in each]))
        if condition.known and not condition.lost:
            out.append(Result(condition.method, "time lost", "%", [lost_time(rides, condition)]))
    return out
