"""Parameters of the safety filter node."""

from __future__ import annotations

from ctrl_rl_core.policies import POSE_PARAMETERS

from ctrl_rl_core import SCAN_PARAMETERS, Parameter
from ctrl_rl_safety.filter.verdict import FilterOptions

_DEFAULT = FilterOptions()

FILTER_PARAMETERS = (
    *SCAN_PARAMETERS,
    Parameter("scan_timeout", 0.5, "Age of the last scan or odometry that stops the robot [s].", 0.05, 10.0),
    Parameter("raw_timeout", 0.5, "Age of the last raw command that counts as zero [s].", 0.05, 10.0),
    Parameter("control_period", 0.05, "Longest time from command to command [s].", 0.02, 0.2),
    Parameter(
        "mover_speed",
        _DEFAULT.mover_speed,
        "Largest speed of people and other robots around; 0.0 where nothing else moves [m/s].",
        0.0,
        5.0,
    ),
    Parameter(
        "mover_acceleration",
        _DEFAULT.mover_acceleration,
        "Largest acceleration of what stood all the time [m/s^2].",
        0.0,
        20.0,
    ),
    Parameter(
        "standing_time",
        _DEFAULT.standing_time,
        "Time for which an echo must stay in place to count as standing [s].",
        0.2,
        20.0,
    ),
    Parameter(
        "mover_size",
        _DEFAULT.mover_size,
        "Largest extent of a mover: what stands and is longer is a wall that never moves; 0.0 for none [m].",
        0.0,
        20.0,
    ),
    Parameter("evade", _DEFAULT.evade, "Whether a robot that would stand goes out of the way of what comes near."),
    Parameter("use_map", False, "Use the topic `map`: what is on it never moves."),
    *POSE_PARAMETERS,
    Parameter(
        "occluded_movers",
        _DEFAULT.occluded_movers,
        "Whether somebody may step out from behind an edge that the scan shows.",
    ),
    Parameter(
        "unseen",
        _DEFAULT.unseen,
        "What the lidar never saw, behind the robot or an edge, counts as this; an obstacle stays where it is.",
        choices=("free", "obstacle"),
    ),
    Parameter(
        "hysteresis",
        _DEFAULT.hysteresis,
        "Margin with which a raw command must be certified to pass again after a correction [m].",
        0.0,
        0.5,
    ),
    Parameter(
        "unblock_after",
        _DEFAULT.unblock_after,
        "Time after which a robot that is held turns to the side with more room; 0.0 for never [s].",
        0.0,
        3600.0,
    ),
)
