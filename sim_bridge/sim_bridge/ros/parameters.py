"""Parameters of the bridge, converted to simulation options."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ctrl_rl_core import Parameter, ParameterError
from sim_bridge.engines.choice import ENGINES
from sim_bridge.ros.localisation import KINDS
from sim_bridge.simulation.lidar import LIDARS
from sim_bridge.simulation.options import SimulationOptions

PARAMETERS = (
    Parameter("task", "curved_corridor", "Navigation task: a name of the suite, or a .yaml file.", kind="path"),
    Parameter("robots", [""], "Namespaces of the robots; [''] for one without."),
    Parameter("seed", 0, "Draws starts, noise and drift of the first episode.", 0),
    Parameter(
        "speed_factor", 1.0, "Simulation time per wall time; 0.0 for as fast as it goes.", 0.0, 1000.0, live=True
    ),
    Parameter(
        "engine",
        "auto",
        "Physics engine; auto is pybullet where installed, else mujoco; planar has no contacts.",
        choices=ENGINES,
    ),
    Parameter("gui", False, "Show PyBullet's window."),
    Parameter("start_paused", False, "Whether to start paused, until ~/pause or ~/step is called."),
    Parameter("physics_rate", 240, "Physics steps per second of simulation time [Hz].", 60, 2000),
    Parameter("odom_rate", 30.0, "Rate of odometry, ground truth and episode states [Hz].", 1.0, 240.0),
    Parameter("clock_rate", 100.0, "Maximum rate of /clock [Hz].", 1.0, 100.0),
    Parameter(
        "lidar",
        "task",
        "Lidar: the task's own, or a TurtleBot3's LDS-01 or LDS-02.",
        choices=LIDARS,
    ),
    Parameter("scan_noise", -1.0, "Standard deviation of a range [m]; -1.0 for the task's.", -1.0, 1.0),
    Parameter("scan_dropout", -1.0, "Probability that a beam is lost; -1.0 for the task's.", -1.0, 1.0),
    Parameter("scan_rate", 0.0, "Scans per second [Hz]; 0.0 for the task's.", 0.0, 60.0),
    Parameter("dropout_value", "nan", "Value of a lost beam of the task's lidar.", choices=("nan", "inf", "zero")),
    Parameter(
        "odom_drift",
        0.0,
        "Standard deviation of odometry's relative errors: distance, rotation, and rotation per metre.",
        0.0,
        0.5,
    ),
    Parameter(
        "localisation",
        "exact",
        "Localisation of the robots on the map: true pose, pose with errors, or none.",
        choices=KINDS,
    ),
    Parameter("localisation_error", 0.05, "Standard deviation of each noisy coordinate [m].", 0.0, 2.0),
    Parameter("localisation_heading_error", 0.0524, "Standard deviation of a noisy heading [rad].", 0.0, 1.0),
    Parameter("localisation_rate", 5.0, "Rate of poses on the map [Hz].", 0.1, 60.0),
    Parameter("friction", 1.0, "Friction coefficient between wheels and floor.", 0.01, 10.0),
    Parameter("wheel_radius", 1.0, "Ratio of the true wheel radius to the one assumed by the robot.", 0.5, 2.0),
    Parameter("motor_lag", 0.0, "Time constant of the wheels' speed; 0.0 for the robot's own [s].", 0.0, 5.0),
    Parameter("randomise", True, "Draw from the ranges of the task file at each reset, if it has any."),
    Parameter("corridor_width", 0.0, "Free width of a corridor [m]; 0.0 for the task's.", 0.0),
    Parameter("randomise_width", False, "Draw the width from the task's range at each reset."),
    Parameter("enable_stamped_cmd_vel", True, "cmd_vel is a TwistStamped (Jazzy), else a Twist (Humble)."),
    Parameter("command_truncation", False, "Cut commands to 0.01 m/s and 0.01 rad/s, as the TurtleBot3 firmware does."),
    Parameter("command_delay", 0.0, "Time from the arrival of a command to its effect [s].", 0.0, 2.0),
    Parameter(
        "cmd_vel_timeout",
        0.5,
        "Simulation time after which a command expires: wheels stop, a quadrotor hovers [s]; 0.0 for never.",
        0.0,
        60.0,
    ),
)


def simulation_options(settings: Mapping[str, Any]) -> SimulationOptions:
    """Convert the parameters to options.

    Raises:
        ParameterError: Two parameters contradict each other.
    """
    if settings["randomise_width"] and settings["corridor_width"] > 0.0:
        raise ParameterError("parameters 'corridor_width' and 'randomise_width' contradict each other: set one of them")
    return SimulationOptions(
        engine=settings["engine"],
        rate=settings["physics_rate"],
        gui=settings["gui"],
        scan_noise=_given(settings["scan_noise"]),
        scan_dropout=_given(settings["scan_dropout"]),
        scan_rate=settings["scan_rate"] or None,
        lost_beam=settings["dropout_value"],
        lidar=settings["lidar"],
        odom_drift=settings["odom_drift"],
        command_truncation=settings["command_truncation"],
        command_delay=settings["command_delay"],
        command_timeout=settings["cmd_vel_timeout"],
        friction=settings["friction"],
        wheel_radius=settings["wheel_radius"],
        motor_lag=settings["motor_lag"] or None,
        randomise=settings["randomise"],
        randomise_width=settings["randomise_width"],
    )


def _given(value: float) -> float | None:
    return None if value < 0.0 else value
