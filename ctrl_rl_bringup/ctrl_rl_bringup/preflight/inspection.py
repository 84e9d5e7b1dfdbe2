"""All checks of a pre-flight, in the order in which they are read."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ctrl_rl_bringup.preflight import frame_checks, motion_checks, robot_checks, scan_checks, time_checks, topic_checks
from ctrl_rl_bringup.preflight.finding import Finding, Level, Limits
from ctrl_rl_bringup.preflight.motion_checks import Motion
from ctrl_rl_bringup.preflight.recording import Recording

STANDING: tuple[Callable[[Recording, Limits], Iterator[Finding]], ...] = (
    topic_checks.check_sensors,
    topic_checks.check_single_source,
    topic_checks.check_command_type,
    topic_checks.check_qos,
    topic_checks.check_commanders,
    time_checks.check_rates,
    time_checks.check_stamps,
    frame_checks.check_names,
    frame_checks.check_tree,
    frame_checks.check_odometry_agrees,
    frame_checks.check_mounting,
    scan_checks.check_beams,
    scan_checks.check_echoes,
    scan_checks.check_own_body,
    scan_checks.check_frozen,
    robot_checks.check_odometry,
    robot_checks.check_battery,
    robot_checks.check_map,
)
MOVING: tuple[Callable[[Motion, Limits], Iterator[Finding]], ...] = (
    motion_checks.check_pattern,
    motion_checks.check_response,
    motion_checks.check_pose,
    motion_checks.check_stands,
)
ON_THE_FLOOR: tuple[Callable[[Motion, Limits], Iterator[Finding]], ...] = (
    motion_checks.check_turn_by_scan,
    motion_checks.check_shift_by_scan,
)
"""Checks that need a robot whose scans move with it."""


def inspect_standing(heard: Recording, limits: Limits) -> list[Finding]:
    """Return what is found on a robot that stands."""
    return [finding for check in STANDING for finding in check(heard, limits)]


def inspect_moving(motion: Motion, limits: Limits, on_the_floor: bool) -> list[Finding]:
    """Return what is found on a robot that drove the pattern."""
    checks = (*MOVING, *(ON_THE_FLOOR if on_the_floor else ()))
    return [finding for check in checks for finding in check(motion, limits)]


def may_go(findings: list[Finding]) -> bool:
    """Return whether nothing keeps the robot from driving."""
    return all(finding.level is not Level.NO_GO for finding in findings)
