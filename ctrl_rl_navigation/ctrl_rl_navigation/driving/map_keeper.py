"""The keeper of the value of a robot that turns on the spot."""

from __future__ import annotations

import numpy as np

from ctrl_rl_navigation.driving.decision import Goal, NavigatorOptions
from ctrl_rl_navigation.driving.value_keeper import Array, ValueKeeper, Work
from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_navigation.values.map_solver import MapSolver
from ctrl_rl_navigation.values.map_value import MapValue

_INSIDE = 0.6
"""Fraction of the goal tolerance at which the value is zero, so that the robot stops well within the tolerance."""


def keep_map_value(limits: DriveLimits, options: NavigatorOptions) -> ValueKeeper[MapSolver, MapValue]:
    """Return a keeper for a robot of the given size and speed."""
    radius, widest = _INSIDE * options.tolerance, options.tolerance

    def plan(solver: MapSolver, goal: Goal, obstacles: Array) -> Work[MapValue]:
        along = None if goal.path is None else (np.array(goal.path), options.corridor)
        return lambda report, wanted: solver.solve(goal.position, radius, obstacles, report, wanted, widest, along)

    return ValueKeeper(lambda map_: MapSolver(map_, limits), plan, options.inline)
