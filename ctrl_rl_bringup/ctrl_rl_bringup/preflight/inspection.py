"""Runs all checks of a pre-flight, in the order of the report, and writes the report."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from ctrl_rl_bringup.preflight import frame_checks, motion_checks, robot_checks, scan_checks, topic_checks
from ctrl_rl_bringup.preflight.finding import Finding, Level, Limits
from ctrl_rl_bringup.preflight.motion_checks import Motion
from ctrl_rl_bringup.preflight.recording import Recording
from ctrl_rl_core import atomic_write

STANDING: tuple[Callable[[Recording, Limits], Iterator[Finding]], ...] = (
    topic_checks.check_sensors,
    topic_checks.check_single_source,
    topic_checks.check_command_type,
    topic_checks.check_qos,
    topic_checks.check_commanders,
    topic_checks.check_rates,
    topic_checks.check_stamps,
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
"""Checks whose scans must move with the robot."""


def inspect_standing(heard: Recording, limits: Limits) -> list[Finding]:
    """Return the findings on a standing robot."""
    return [finding for check in STANDING for finding in check(heard, limits)]


def inspect_moving(motion: Motion, limits: Limits, on_the_floor: bool) -> list[Finding]:
    """Return the findings on a robot that drove the pattern."""
    checks = (*MOVING, *(ON_THE_FLOOR if on_the_floor else ()))
    return [finding for check in checks for finding in check(motion, limits)]


def may_go(findings: list[Finding]) -> bool:
    """Return whether the robot may drive."""
    return all(finding.level is not Level.NO_GO for finding in findings)


def as_text(findings: Sequence[Finding]) -> str:
    """Return a line per finding, one with its advice, and the verdict."""
    lines = []
    for finding in findings:
        lines.append(f"{finding.level.value:<9} {finding.check:<24} {finding.text}")
        if finding.advice:
            lines.append(f"{'':<34}> {finding.advice}")
    return "\n".join((*lines, "", verdict(findings)))


def verdict(findings: Sequence[Finding]) -> str:
    """Return go or no-go in one line."""
    count = {level: sum(finding.level is level for finding in findings) for level in Level}
    rest = f"{count[Level.OK]} ok, {count[Level.NOTE]} to note, {count[Level.LEFT_OUT]} left out"
    return f"GO: {rest}" if may_go(list(findings)) else f"NO-GO: {count[Level.NO_GO]} wrong, {rest}"


def write_report(folder: Path, findings: Sequence[Finding], limits: Limits) -> None:
    """Write preflight.txt and preflight.json into a folder, each atomically.

    Raises:
        OSError: A file cannot be written; the error names it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "go": may_go(list(findings)),
        "findings": [{**asdict(finding), "level": finding.level.value} for finding in findings],
        "limits": asdict(limits),
    }
    atomic_write(folder / "preflight.json", json.dumps(content, indent=1) + "\n")
    atomic_write(folder / "preflight.txt", as_text(findings) + "\n")
