"""Drive on each map in each engine, plan the same drives by a hybrid A*, and print a line each."""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ctrl_rl_core.command import EXIT_USAGE
from ctrl_rl_core.io import add_results
from ctrl_rl_navigation.cars import CarSolver, car_limits_of
from tqdm import tqdm

from cars.drives import Drives, Ride, Trial, draw_trials, make_options
from cars.hybrid_a_star import HybridAStar
from cars.maps import Place, make_place
from ctrl_rl_core import Result, find_robot, parse_options
from sim_bridge import ENGINES

MAPS = ("office", "maze", "parking")
_NEAR = 3.0
"""Optimal time below which a drive is not timed [s], because speeding up and stopping are then a large part of it."""
_HYBRID = "hybrid A*, plan alone"


@dataclass
class Options:
    """Drive cars to goals with a heading on three maps; 1 if one touches something or does not arrive."""

    maps: tuple[str, ...] = MAPS
    """Names of the maps; one whose data are absent is left out."""
    engines: tuple[str, ...] = ("planar",)
    """Engines of the drives; none for plans alone."""
    goals: int = 100
    """Number of goals per map and engine."""
    plans: int = 100
    """Number of goals per map to which the hybrid A* plans as well."""
    filter: bool = False
    """Whether the safety filter stands between navigator and car."""
    seed: int = 0
    """Seed of maps, starts and goals."""
    output: Path | None = None
    """JSON file for the results; rows of other maps and engines stay."""


def main() -> int:
    """Drive; 0 if each goal that has a way was reached without a contact, else 1."""
    options = parse_options("cars", Options)
    unknown = [name for name in options.maps if name not in MAPS]
    unknown += [name for name in options.engines if name not in ENGINES]
    if unknown or min(options.goals, options.plans + 1, options.seed + 1) < 1:
        known = f"no {unknown[0]}: there are maps {', '.join(MAPS)} and engines {', '.join(ENGINES)}" if unknown else ""
        print(f"cars: {known or '--goals: 1 or more'}; --plans, --seed: 0 or more", file=sys.stderr)
        return EXIT_USAGE
    failed = 0
    for name in options.maps:
        place = make_place(name, options.seed)
        if place is None:
            print(f"{name}: its data are not here, so it is left out")
            continue
        for engine in options.engines:
            failed += _drive(place, engine, options)
        if options.plans:
            _plan(place, options)
    return int(failed > 0)


def _drive(place: Place, engine: str, options: Options) -> int:
    """Drive on a map, write the results, and return the number of goals that were missed."""
    drives, done = Drives(place, engine, options.filter), list[Ride]()
    try:
        trials = draw_trials(place, drives.solver, options.goals, options.seed)
        for number, trial in enumerate(tqdm(trials, desc=f"{place.name}, {engine}", unit=" drives", disable=None)):
            done.append(drives.ride(trial, options.seed + number))
            _say(place.name, number, trial, done[-1])
    finally:
        drives.close()
    method = f"{place.name}, {place.robot}, {engine}{', filter' if options.filter else ''}"
    rows = rows_of(method, done, drives.prepared)
    _tell(method, rows, options)
    return sum(math.isfinite(each.optimal) and not each.arrived for each in done)


def rows_of(method: str, done: list[Ride], prepared: float) -> list[Result]:
    """Return the results as data, a value a goal; arrivals count where there is a way."""
    with_way = [each for each in done if math.isfinite(each.optimal)]
    timed = [each.seconds / each.optimal for each in with_way if each.arrived and each.optimal >= _NEAR]
    rows = [
        Result(method, "arrived", "1", [float(each.arrived) for each in with_way]),
        Result(method, "contacts", "1", [float(each.contact) for each in done]),
        Result(method, "time over optimal", "1", timed),
        Result(method, "solve seconds", "s", [each.solve_seconds for each in with_way]),
        Result(method, "map seconds", "s", [prepared]),
    ]
    return [row for row in rows if row.values]


def _plan(place: Place, options: Options) -> None:
    """Plan by the hybrid A*, and write the results."""
    limits, settings = car_limits_of(find_robot(place.robot)), make_options()
    solver = CarSolver(place.map, limits)
    planner = HybridAStar(place.map, limits, solver.grid.resolution)
    found, over, seconds = list[float](), list[float](), list[float]()
    tolerances = 0.6 * settings.tolerance, 0.6 * settings.heading_tolerance
    trials = draw_trials(place, solver, options.plans, options.seed)
    for trial in tqdm(trials, desc=f"{place.name}, hybrid A*", unit=" plans", disable=None):
        goal, heading = (float(trial.goal[0]), float(trial.goal[1])), float(trial.goal[2])
        optimal = float(solver.solve(goal, heading, *tolerances).value(trial.start))
        if not math.isfinite(optimal):
            continue
        begin = time.monotonic()
        plan = planner.plan(trial.start, goal, heading, tolerances)
        seconds.append(time.monotonic() - begin)
        found.append(float(math.isfinite(plan.seconds)))
        if math.isfinite(plan.seconds) and optimal >= _NEAR:
            over.append(plan.seconds / optimal)
    method = f"{place.name}, {place.robot}, {_HYBRID}"
    rows = [
        Result(method, "arrived", "1", found),
        Result(method, "time over optimal", "1", over),
        Result(method, "solve seconds", "s", seconds),
    ]
    _tell(method, [row for row in rows if row.values], options)


def _tell(method: str, rows: list[Result], options: Options) -> None:
    if options.output is not None:
        add_results(options.output, "Cars to goals with a heading", [options.seed], rows)
    print(f"{method}: " + ", ".join(f"{row.metric} {np.mean(row.values):.3f}" for row in rows))


def _say(name: str, number: int, trial: Trial, ride: Ride) -> None:
    what = "contact" if ride.contact else ride.state.name.lower()
    (x, y, theta), (a, b, c) = trial.start, trial.goal
    away, turned = ride.missed
    tqdm.write(
        f"{name} {number}: ({x:.2f}, {y:.2f}, {theta:.2f}) to ({a:.2f}, {b:.2f}, {c:.2f}): {what} after "
        f"{ride.seconds:.1f} s, optimal {ride.optimal:.1f} s, solved in {ride.solve_seconds:.1f} s, "
        f"{away:.2f} m and {math.degrees(turned):.0f} degrees from the goal"
    )
