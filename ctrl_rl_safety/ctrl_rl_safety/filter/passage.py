"""The least width of a door through which the certificate lets a robot drive.

Beside a robot in a door there must be room for the errors of echoes, for its deviation from its model until it has
stopped, and for the motion between two time steps. The certificate itself says how much, for a straight drive between
two rows of echoes.
"""

from __future__ import annotations

import math

import numpy as np

from ctrl_rl_safety.filter.certificate import certify
from ctrl_rl_safety.filter.safety_filter import STEP
from ctrl_rl_safety.filter.situation import NO_GUIDE, Situation
from ctrl_rl_safety.filter.verdict import FilterOptions
from ctrl_rl_safety.models.growth import Growth
from ctrl_rl_safety.models.motion import motion_of
from ctrl_rl_safety.models.robot_model import RobotModel
from ctrl_rl_safety.sets.distance_field import FAR, NONE, obstacles_around

_SPACING = 0.01
"""Spacing of the echoes on a wall [m]."""
_ROUNDING = 1e-6


def least_passage(
    model: RobotModel,
    speed: float,
    options: FilterOptions | None = None,
    scan_interval: float = 0.1,
    echo_error: float | None = None,
) -> float:
    """Return the width of the narrowest door in whose middle a robot's speed is always certified [m].

    Args:
        model: The robot.
        speed: Speed in the door [m/s].
        options: Settings of the filter.
        scan_interval: Time from scan to scan [s].
        echo_error: Maximum distance by which echoes lie nearer than the door's sides [m]; `range_error` by default,
            with which no noise that the model allows for can stop the robot.
    """
    value = options or FilterOptions()
    hold = max(1, math.ceil(value.period / STEP))
    reach = speed * (hold * STEP + model.lag) + model.stopping_distance(speed) + model.radius + model.half_width
    along = np.arange(-reach, reach, _SPACING)
    age = model.scan_age + scan_interval + STEP * math.ceil(model.delay / STEP - 1e-9)
    half, margin = model.half_width + model.range_error, -math.inf
    while margin < 0.0:
        walls = np.column_stack((np.tile(along, 2), np.repeat((-half, half), len(along))))
        situation = Situation(
            obstacles_around(walls, NONE, NONE, (0.0, 0.0), _SPACING),
            Growth(model.disturbance),
            motion_of(model, STEP),
            NO_GUIDE,
            model.core,
            (model.room, model.room),
            False,
            hold,
            model.turn_rate,
            model.lag,
        )
        margin, _ = certify(situation, (0.0, 0.0, 0.0, speed, 0.0), age, (speed, 0.0), hold, 0, FAR)
        half += 0.0 if margin >= 0.0 else _ROUNDING - margin
    return 2.0 * (half + (model.range_error if echo_error is None else echo_error))
