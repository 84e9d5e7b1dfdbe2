"""Drive every robot with every fault, and print a line each."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ctrl_rl_core.command import EXIT_USAGE
from tqdm import tqdm

from ctrl_rl_core import Result, parse_options, write_results
from ctrl_rl_safety import ROBOTS, find_model
from wrong_model.drives import Fault, Ride, ride

WALKING = 1.0
"""Speed of somebody who walks [m/s]."""
WORSE = Fault("20 % less braking, 0.15 s more delay", braking=0.8, delay=0.15)
FAULTS = (
    Fault("as its model says"),
    WORSE,
    Fault("20 % less braking, 0.15 s more delay after 5 s", braking=0.8, delay=0.15, begins=5.0),
    Fault("40 % less braking, 0.3 s more delay", braking=0.6, delay=0.3),
    Fault("lidar turned by 15 degrees", yaw=math.radians(15.0)),
)
"""Faults of the trial; the motion differs from the first metre on unless the name says otherwise."""


@dataclass
class Options:
    """Count contacts of filtered robots that are worse than their models; 1 if one happens that must not."""

    episodes: int = 50
    """Number of episodes of each robot with the fault that the monitor must bear; a tenth of it with the others."""
    seed: int = 0
    """Seed of the first episode; the others follow it."""
    robots: tuple[str, ...] = tuple(ROBOTS)
    """Names of the robots."""
    output: Path | None = None
    """JSON file for the results."""


@dataclass(frozen=True)
class Condition:
    """One robot with one fault.

    Attributes:
        robot: Name of the robot.
        fault: How it differs from its model.
        speed: Maximum speed commanded [m/s].
        monitored: Whether the filter has a monitor.
    """

    robot: str
    fault: Fault
    speed: float
    monitored: bool

    @property
    def method(self) -> str:
        """Name in results."""
        return f"{self.robot}, {self.speed:g} m/s, {self.fault.name}" + ("" if self.monitored else ", no monitor")

    @property
    def counts(self) -> bool:
        """Whether it is what the monitor must bear."""
        return self.monitored and self.fault is WORSE

    @property
    def promised(self) -> bool:
        """Whether no contact may happen: what the monitor must bear, at the speed of somebody who walks."""
        return self.counts and self.speed <= WALKING


def main() -> int:
    """Drive; 0 if no contact happened that must not, else 1."""
    options = parse_options("wrong_model", Options)
    unknown = [name for name in options.robots if name not in ROBOTS]
    if unknown or min(options.episodes, options.seed + 1) < 1:
        wrong = f"no robot {unknown[0]}: there are {', '.join(ROBOTS)}" if unknown else "--episodes: 1 or more"
        print(f"wrong_model: {wrong}; --seed: 0 or more", file=sys.stderr)
        return EXIT_USAGE
    seeds = range(options.seed, options.seed + options.episodes)
    conditions = list(_conditions(options.robots))
    bar = tqdm(desc="wrong_model", unit=" episodes", disable=None)
    rides: dict[Condition, list[Ride]] = {each: [] for each in conditions}
    with bar:
        for each in conditions:
            for seed in seeds if each.counts else seeds[: math.ceil(0.1 * len(seeds))]:
                rides[each].append(ride(each.robot, seed, each.fault, each.speed, each.monitored))
                bar.update()
    print(table(rides))
    if options.output is not None:
        write_results(options.output, "Rushing at poles with a wrong model", list(seeds), rows(rides))
    return int(any(one.contact for each, all_ in rides.items() if each.promised for one in all_))


def _conditions(robots: tuple[str, ...]) -> Iterator[Condition]:
    for robot in robots:
        top = find_model(robot).speed
        for speed in sorted({min(WALKING, top), top}):
            for fault in FAULTS:
                yield from (Condition(robot, fault, speed, monitored) for monitored in (True, False))


def table(rides: dict[Condition, list[Ride]]) -> str:
    """Return a line a condition."""
    heads = (
        f"{'episodes':>9}{'contacts':>9}{'least room [m]':>15}{'grown after [s]':>16}{'stopped':>8}{'time lost':>10}"
    )
    lines = [f"{'condition':<86}{heads}"]
    for condition, each in rides.items():
        values = [one.grown for one in each if not math.isnan(one.grown)]
        grown = f"{np.median(values):.2f}" if values else ""
        lost = f"{lost_time(rides, condition):.1f} %" if condition.monitored and condition.fault is FAULTS[0] else ""
        contacts, least = sum(one.contact for one in each), min(one.clearance for one in each)
        stopped = sum(one.stands for one in each)
        lines.append(
            f"{condition.method:<86}{len(each):>9}{contacts:>9}{least:>15.3f}{grown:>16}{stopped:>8}{lost:>10}"
        )
    return "\n".join(lines)


def lost_time(rides: dict[Condition, list[Ride]], condition: Condition) -> float:
    """Return by how much less the robot gets on in the same time than without a monitor [%]."""
    alone = rides[Condition(condition.robot, condition.fault, condition.speed, False)]
    return 100.0 * (1.0 - sum(each.distance for each in rides[condition]) / sum(each.distance for each in alone))


def rows(rides: dict[Condition, list[Ride]]) -> list[Result]:
    """Return the results as data: contacts, how soon bounds grew, and the time lost where the model is right."""
    out = []
    for condition, each in rides.items():
        out.append(Result(condition.method, "contacts", "1", [float(one.contact) for one in each]))
        if not condition.monitored:
            continue
        values = [one.grown for one in each if not math.isnan(one.grown)]
        if values:
            out.append(Result(condition.method, "bounds grown after", "s", values))
        if condition.fault is FAULTS[0]:
            out.append(
                Result(condition.method, "bounds grown", "1", [float(not math.isnan(one.grown)) for one in each])
            )
            out.append(Result(condition.method, "time lost", "%", [lost_time(rides, condition)]))
    return out
