"""Parameters of the flight guard node."""

from __future__ import annotations

from ctrl_rl_core import Parameter
from ctrl_rl_safety.flight.flight_guard import FlightOptions

_DEFAULT = FlightOptions()

FLIGHT_PARAMETERS = (
    Parameter(
        "task",
        "quad_ttr",
        "Navigation task with the quadrotor's constants, walls and obstacles: a name of the suite, or a .yaml file.",
        kind="path",
    ),
    Parameter("mass", 0.0, "Mass of the quadrotor; 0.0 for the task's [kg].", 0.0, 1000.0),
    Parameter(
        "disturbance",
        0.0,
        "Bound of the acceleration's deviation from the model, by wind or another mass [m/s^2].",
        0.0,
        100.0,
    ),
    Parameter("goal", False, "Whether a flight ends in the task's goal, so that an escape may end there too."),
    Parameter(
        "period",
        _DEFAULT.tick,
        "Maximum interval between thrusts; odometry must arrive at least as often [s].",
        0.005,
        0.1,
    ),
    Parameter("margin", _DEFAULT.margin, "Clearance that an escape must keep [m].", 0.0, 1.0),
    Parameter(
        "hysteresis",
        _DEFAULT.hysteresis,
        "Additional clearance required for raw thrusts to pass again after a correction [m].",
        0.0,
        1.0,
    ),
    Parameter(
        "delay",
        0.0,
        "Time from the odometry's stamp until thrusts take effect; at most the period [s].",
        0.0,
        0.1,
    ),
    Parameter("raw_timeout", 0.25, "Age of the last raw thrusts from which on it brakes and hovers [s].", 0.02, 10.0),
    Parameter("odometry_timeout", 0.2, "Age of odometry on arrival above which it is refused [s].", 0.02, 10.0),
    Parameter(
        "hover_for",
        10.0,
        "Time without raw thrusts after which nothing is sent, so that the watchdog takes over; 0.0 for never [s].",
        0.0,
        3600.0,
    ),
)
