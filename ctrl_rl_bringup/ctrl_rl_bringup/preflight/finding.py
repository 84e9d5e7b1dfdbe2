"""Findings of a pre-flight, and its limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from ctrl_rl_core.command import FiniteNumber
from ctrl_rl_core.errors import printable
from ctrl_rl_core.robots import DEFAULT_ROBOT

from ctrl_rl_core import Robot, find_robot


class Level(Enum):
    """How bad a finding is."""

    OK = "ok"
    NOTE = "note"
    NO_GO = "NO-GO"
    LEFT_OUT = "left out"


@dataclass(frozen=True)
class Finding:
    """What one check found.

    Attributes:
        check: Name of the check.
        level: Severity: ok, note, no-go, or left out.
        text: The finding in one line, with its figures.
        advice: What the user can do; empty if nothing is to be done.
    """

    check: str
    level: Level
    text: str
    advice: str = ""

    def __post_init__(self) -> None:
        """Escape unprintable characters: senders choose the names of frames and nodes."""
        object.__setattr__(self, "text", printable(self.text).replace("\n", " "))
        object.__setattr__(self, "advice", printable(self.advice).replace("\n", " "))


def ok(check: str, text: str) -> Finding:
    """Make a finding that nothing is wrong."""
    return Finding(check, Level.OK, text)


def note(check: str, text: str, advice: str = "") -> Finding:
    """Make a finding that the user should know, but that does not prevent driving."""
    return Finding(check, Level.NOTE, text, advice)


def no_go(check: str, text: str, advice: str) -> Finding:
    """Make a finding that prevents driving."""
    return Finding(check, Level.NO_GO, text, advice)


def left_out(check: str, text: str) -> Finding:
    """Make a finding that a check was left out, and why."""
    return Finding(check, Level.LEFT_OUT, text)


_USUAL = find_robot(DEFAULT_ROBOT)


@dataclass(frozen=True)
class Limits:
    """Limits of the checks for this suite's controllers; properties of the robot come from `--robot` unless given."""

    scan_rate: FiniteNumber = 4.0
    """Minimum scans per second [Hz]."""

    odom_rate: FiniteNumber = 10.0
    """Minimum odometry messages per second [Hz]."""

    largest_gap: FiniteNumber = 0.5
    """Maximum silence of scan or odometry [s]; the controllers stop the robot after 0.5 s."""

    largest_age: FiniteNumber = 0.5
    """Maximum age of a stamp on arrival, by this computer's clock [s]."""

    largest_lead: FiniteNumber = 0.1
    """Maximum lead of a stamp over this computer's clock [s]."""

    echo_share: FiniteNumber = 0.3
    """Minimum share of beams with an echo, 0 to 1."""

    field: FiniteNumber = 180.0
    """Minimum field of view of the lidar [deg]."""

    lidar_x: FiniteNumber = _USUAL.lidar.x
    """Position of the lidar ahead of base_link that the controller is told [m]."""

    lidar_yaw: FiniteNumber = _USUAL.lidar.yaw
    """Direction of the scan's zero bearing in the robot's frame that the controller is told [rad]."""

    lidar_x_tolerance: FiniteNumber = 0.05
    """Maximum difference between lidar_x and TF [m]."""

    lidar_yaw_tolerance: FiniteNumber = 0.1
    """Maximum difference between lidar_yaw and TF [rad]."""

    least_charge: FiniteNumber = 0.2
    """Minimum charge of the battery, 0 to 1."""

    least_voltage: FiniteNumber = _USUAL.least_voltage
    """Minimum voltage of the battery [V]."""

    robot_radius: FiniteNumber = _USUAL.radius
    """Radius around base_link that contains the robot [m]; no echo can lie within."""

    map_share: FiniteNumber = 0.6
    """Minimum share of echoes that lie near an occupied cell of the map, 0 to 1."""

    map_distance: FiniteNumber = 0.15
    """Distance from an occupied cell up to which an echo counts as near [m]."""

    scale_tolerance: FiniteNumber = 0.2
    """Maximum relative difference between commands, odometry and scan while the robot moves."""

    largest_delay: FiniteNumber = 0.5
    """Maximum time from a command to its effect in odometry [s]."""

    def of(self, robot: Robot) -> Limits:
        """Replace default properties of the robot by those of another one."""
        own = _of(robot)
        return replace(self, **{name: own[name] for name, usual in _of(_USUAL).items() if getattr(self, name) == usual})


def _of(robot: Robot) -> dict[str, float]:
    return {
        "lidar_x": robot.lidar.x,
        "lidar_yaw": robot.lidar.yaw,
        "least_voltage": robot.least_voltage,
        "robot_radius": robot.radius,
    }
