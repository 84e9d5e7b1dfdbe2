"""Size of the grid around the robot on which distances are kept and the recoverable set is solved."""

from __future__ import annotations

from ctrl_rl_safety.filter.verdict import FilterOptions
from ctrl_rl_safety.models.robot_model import RobotModel
from ctrl_rl_safety.sets.distance_field import NODES
from ctrl_rl_safety.sets.recoverable_set import brake_ladder

_LEAST_CELL = 0.025
_LATEST = 0.5
"""Scan age for which the grid is sized [s]."""


def grid_around(model: RobotModel, options: FilterOptions) -> tuple[float, float]:
    """Return the spacing of nodes that covers the stop of a robot, and the reach within which echoes matter [m]."""
    ladder = brake_ladder(model)
    top = float(ladder.speeds[-1])
    latest = _LATEST + model.scan_age + model.delay + options.period
    half = top * latest + model.stopping_distance(top) + model.radius + model.range_error
    cell = max(2.0 * half / (NODES - 1), _LEAST_CELL)
    coming = (options.mover_speed + model.disturbance) * (latest + ladder.time_to_stand(top))
    return cell, 0.71 * cell * NODES + model.radius + model.range_error + coming
