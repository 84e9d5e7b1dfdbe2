"""The keeper of a car's value, whose solves end a while beyond the car's own pose."""

from __future__ import annotations

from collections.abc import Callable

from ctrl_rl_navigation.cars.car_limits import CarLimits
from ctrl_rl_navigation.cars.car_solver import CarSolver
from ctrl_rl_navigation.cars.car_value import CarValue
from ctrl_rl_navigation.driving.decision import Goal, NavigatorOptions
from ctrl_rl_navigation.driving.value_keeper import Array, ValueKeeper, Work

_INSIDE = 0.6
"""Fraction of the tolerances at which the value is zero, so that the car stops well within them."""


def keep_car_value(
    limits: CarLimits, options: NavigatorOptions, pose_now: Callable[[], Array | None]
) -> ValueKeeper[CarSolver, CarValue]:
    """Return a keeper for a car.

    Args:
        limits: Size and limits of the car.
        options: Settings of the navigator.
        pose_now: Returns the car's pose (3,) [m, m, rad] when a solve starts; None to solve all of the map.
    """

    def plan(solver: CarSolver, goal: Goal, obstacles: Array) -> Work[CarValue]:
        pose = pose_now()
        return lambda report, wanted: solver.solve(
            goal.position,
            goal.heading,
            _INSIDE * options.tolerance,
            _INSIDE * options.heading_tolerance,
            obstacles,
            report,
            wanted,
            pose,
        )

    return ValueKeeper(lambda map_: CarSolver(map_, limits), plan, options.inline)
