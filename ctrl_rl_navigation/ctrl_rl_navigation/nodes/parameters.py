"""Parameters of the navigator node."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ctrl_rl_core.navigation import POSE_SOURCES
from ctrl_rl_core.ros import robot_parameter

from ctrl_rl_core import LIDAR_PARAMETERS, Parameter

_ALL_WAY = 6.3
_CHANGED: dict[str, dict[str, Any]] = {
    # With a map, a scan with few echoes is no reason to stop: a hall may be wider than the lidar's range.
    "min_echo_share": {"default": 0.02},
    "largest_gap": {"default": _ALL_WAY},
    # Values and roll-outs are computed for a fixed size of the robot.
    "robot_radius": {"live": False, "minimum": 0.01},
    "obstacle_margin": {"live": False},
    "deceleration": {"live": False},
    "reaction_time": {"live": False},
}

NAVIGATOR_PARAMETERS = (
    *(replace(parameter, **_CHANGED.get(parameter.name, {})) for parameter in LIDAR_PARAMETERS),
    Parameter("scan_timeout", 0.5, "Age of the last scan or odometry that stops the robot [s].", 0.05, 10.0),
    Parameter("map", "", "Name of a map, or a .yaml file of map_server; empty for the topic `map`.", kind="path"),
    Parameter("map_frame", "map", "Frame of the map.", kind="name"),
    Parameter(
        "pose",
        "tf",
        "Source of the pose: the transform from map_frame to the robot, or the topic amcl_pose and odometry since.",
        choices=POSE_SOURCES,
    ),
    Parameter("pose_timeout", 2.0, "Age of a transform above which the robot stops [s].", 0.05, 60.0),
    Parameter("control_period", 0.1, "Time from command to command [s].", 0.02, 0.5),
    robot_parameter("max_speed", "plan.speed", "Largest speed [m/s].", 0.01, 20.0),
    robot_parameter("max_turn_rate", "plan.turn_rate", "Maximum turn rate [rad/s].", 0.05, 50.0),
    robot_parameter("acceleration", "plan.acceleration", "Maximum acceleration [m/s^2].", 0.05, 100.0),
    robot_parameter(
        "turn_acceleration", "plan.turn_acceleration", "Maximum angular acceleration [rad/s^2].", 0.05, 500.0
    ),
    Parameter("goal_tolerance", 0.15, "Distance from the goal at which it is reached [m].", 0.03, 2.0),
    Parameter(
        "goal_heading_tolerance",
        0.2,
        "Heading tolerance at the goal; 3.2 for any heading [rad].",
        0.02,
        3.2,
    ),
    Parameter(
        "obstacle_memory",
        10.0,
        "Time after which an obstacle that was seen only briefly, or before the current goal, is dropped [s].",
        0.5,
        3600.0,
    ),
    Parameter(
        "max_detour",
        300.0,
        "Time that unmapped obstacles may add to the way before the robot stands [s].",
        1.0,
        86400.0,
    ),
    Parameter(
        "actions",
        "all",
        "Actions to serve: navigate (to poses and waypoints), follow_path (in the place of Nav2's controller, with "
        "goal_pose left to Nav2), all, or none.",
        choices=("all", "navigate", "follow_path", "none"),
    ),
    Parameter(
        "goal_patience",
        30.0,
        "Time for which a robot may be blocked or lack an input before the goal of an action is aborted [s].",
        1.0,
        86400.0,
    ),
    Parameter("path_corridor", 0.5, "Distance from a path to follow within which the robot drives [m].", 0.1, 10.0),
)
ANY_HEADING = 3.1415
