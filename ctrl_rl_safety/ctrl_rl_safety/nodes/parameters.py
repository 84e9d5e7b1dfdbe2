"""Parameters of the safety filter node."""

from __future__ import annotations

from ctrl_rl_core.policies import POSE_PARAMETERS
from ctrl_rl_core.ros import robot_parameter

from ctrl_rl_core import SCAN_PARAMETERS, Parameter
from ctrl_rl_safety.filter.verdict import FilterOptions

_DEFAULT = FilterOptions()

FILTER_PARAMETERS = (
    *SCAN_PARAMETERS,
    robot_parameter(
        "missing_rate",
        "lidar.missing_rate",
        "Probability that a scan misses what its beams hit; 0.0 to trust each scan alone.",
        0.0,
        0.5,
    ),
    Parameter("monitor", True, "Whether to compare the robot's motion with its model, and its scans with each other."),
    Parameter(
        "unproven_braking", 0.2, "Fraction of the braking not relied on before the robot has shown it.", 0.0, 0.5
    ),
    Parameter("unproven_delay", 0.15, "Delay reckoned with before the robot has shown to be quicker [s].", 0.0, 1.0),
    Parameter("scan_timeout", 0.5, "Age of the last scan or odometry that stops the robot [s].", 0.05, 10.0),
    Parameter("raw_timeout", 0.5, "Age of the last raw command that counts as zero [s].", 0.05, 10.0),
    Parameter("control_period", 0.05, "Maximum interval between commands [s].", 0.02, 0.2),
    Parameter(
        "mover_speed",
        _DEFAULT.mover_speed,
        "Maximum speed of people and other robots; 0.0 if nothing else moves [m/s].",
        0.0,
        5.0,
    ),
    Parameter(
        "mover_acceleration",
        _DEFAULT.mover_acceleration,
        "Maximum acceleration of obstacles seen as static [m/s^2].",
        0.0,
        20.0,
    ),
    Parameter(
        "standing_time",
        _DEFAULT.standing_time,
        "Time for which an echo must stay in place to count as static [s].",
        0.2,
        20.0,
    ),
    Parameter(
        "mover_size",
        _DEFAULT.mover_size,
        "Maximum extent of a mover: a longer static surface counts as a wall that never moves; 0.0 for none [m].",
        0.0,
        20.0,
    ),
    Parameter("evade", _DEFAULT.evade, "Whether a stationary robot moves out of the way of approaching movers."),
    Parameter("use_map", False, "Whether to use the topic `map`, whose obstacles never move."),
    *POSE_PARAMETERS,
    Parameter(
        "occluded_movers",
        _DEFAULT.occluded_movers,
        "Whether movers may emerge from behind an edge in the scan.",
    ),
    Parameter(
        "unseen",
        _DEFAULT.unseen,
        "Treatment of unseen space, behind the robot or an edge; as an obstacle, it is static.",
        choices=("free", "obstacle"),
    ),
    Parameter(
        "hysteresis",
        _DEFAULT.hysteresis,
        "Margin required for a raw command to pass again after a correction [m].",
        0.0,
        0.5,
    ),
    Parameter(
        "unblock_after",
        _DEFAULT.unblock_after,
        "Time after which a blocked robot turns to the side with more room; 0.0 for never [s].",
        0.0,
        3600.0,
    ),
)
