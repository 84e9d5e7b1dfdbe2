"""Checks of a robot that drove the pattern: odometry and scans against commands."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from ctrl_rl_core.tasks import wrap

from ctrl_rl_bringup.preflight.finding import Finding, Limits, left_out, no_go, note, ok
from ctrl_rl_bringup.preflight.mover import Part
from ctrl_rl_bringup.preflight.recording import OdometrySample, Points, Recording
from ctrl_rl_bringup.preflight.robot_checks import STANDS
from ctrl_rl_bringup.preflight.scan_checks import shift_mismatches, turn_mismatches

_SETTLED_S = 0.6
"""Time at the end of a rest in which the robot stands [s]."""
_CLEARER = 0.7
"""A hypothesis is believed if its mismatch is below this fraction of the other's."""
_LEAST_MISMATCH = 0.012
"""Mismatch of two scans from one place [m]: noise, and the spacing of echoes."""


class Motion(NamedTuple):
    """A pattern as driven, with the recording of that time."""

    heard: Recording
    parts: Sequence[Part]

    def odometry(self, begin: float, end: float) -> list[OdometrySample]:
        """Return the odometry that arrived between two steady times [s]."""
        return [each for each in self.heard.odometry if begin <= each.times.arrival < end]

    def points(self, rest: Part, limits: Limits) -> Points:
        """Return the echoes (n, 2) [m] of the scans at the end of a rest."""
        scans = [each for each in self.heard.scans if rest.end - _SETTLED_S <= each.times.arrival < rest.end]
        sets = [each.points(limits.lidar_x, limits.lidar_yaw) for each in scans[-3:]]
        return np.concatenate(sets) if sets else np.empty((0, 2))

    def around(self, name: str) -> tuple[Part, Part, Part] | None:
        """Return a phase with the rests before and after it; None if the pattern ended earlier."""
        for before, part, after in zip(self.parts, self.parts[1:], self.parts[2:], strict=False):
            if part.phase.name == name and not after.stopped:
                return before, part, after
        return None


def check_pattern(motion: Motion, _limits: Limits) -> Iterator[Finding]:
    """Find whether an obstacle or an unusable scan interrupted the pattern."""
    last = motion.parts[-1]
    if last.stopped:
        words = f"stopped in '{last.phase.name}': {last.stopped}"
        yield no_go("drive", words, "give the robot a metre of free space, and see to the scan")
    else:
        yield ok("drive", f"the whole pattern in {last.end - motion.parts[0].begin:.0f} s")


def check_response(motion: Motion, limits: Limits) -> Iterator[Finding]:
    """Find wrong signs and scales of the odometry against the commands, and long delays."""
    delays = []
    for what, phases in (("turn rate", ("turn left", "turn right")), ("speed", ("ahead", "back"))):
        ratios = []
        for name in phases:
            around = motion.around(name)
            if around is not None:
                ratio, delay = _response(motion, around[1])
                ratios.append(ratio)
                delays.append(delay)
        if ratios:
            yield _scale_finding(f"{what} by odometry", "commands", ratios, limits.scale_tolerance)
    if not delays:
        return
    delay = float(np.max(delays))
    if delay > limits.largest_delay:
        advice = "see to the Wi-Fi and to the load of the robot's computer"
        words = f"more than {limits.largest_delay:g} s" if math.isinf(delay) else f"{delay:.2f} s"
        yield no_go("delay", f"a command takes effect after {words}: at most {limits.largest_delay:g} s", advice)
    else:
        yield ok("delay", f"a command takes effect after {delay:.2f} s at most")


def check_pose(motion: Motion, limits: Limits) -> Iterator[Finding]:
    """Find odometry whose pose contradicts its speeds."""
    ratios = []
    for name in ("ahead", "back"):
        around = motion.around(name)
        samples = motion.odometry(around[0].end - _SETTLED_S, around[2].end) if around is not None else []
        if len(samples) < 2:
            continue
        way, expected = _way(samples), _integrated_way(samples)
        if abs(expected) > 0.02:
            ratios.append(way / expected)
    if ratios:
        yield _scale_finding("way by odometry", "its own speed", ratios, limits.scale_tolerance)


def check_stands(motion: Motion, _limits: Limits) -> Iterator[Finding]:
    """Find a robot that keeps moving after a zero command, or after commands stop."""
    rests = [part for part in motion.parts[1:] if part.phase.name == "rest"]
    moving = [fast for part in rests if (fast := _speed_at_end(motion, part)) is not None]
    if moving:
        v, omega = np.max(moving, axis=0)
        words = f"{v:.2f} m/s, {omega:.2f} rad/s at the end of a rest"
        if v > STANDS[0] or omega > STANDS[1]:
            yield no_go("stands after zero", words, "the base does not obey a zero: do not drive, see its firmware")
        else:
            yield ok("stands after zero", words)
    silent = next((part for part in motion.parts if part.phase.silent), None)
    end = _speed_at_end(motion, silent) if silent is not None else None
    if silent is None or end is None:
        return
    words = f"{end[1]:.2f} rad/s {silent.end - silent.begin:.1f} s after the last command"
    if end[1] > STANDS[1]:
        advice = "run the watchdog on the robot (ros2 run ctrl_rl_core watchdog) and drive by --commands cmd_vel_raw"
        yield no_go("stands without commands", f"the robot goes on: {words}", advice)
    else:
        yield ok("stands without commands", words)


def check_turn_by_scan(motion: Motion, limits: Limits) -> Iterator[Finding]:
    """Find a mirrored or upside-down lidar, and odometry that turns differently from the scans."""
    check, around = "turn by scan", motion.around("turn left")
    if around is None:
        return
    samples = motion.odometry(around[0].end - _SETTLED_S, around[2].end)
    before, after = motion.points(around[0], limits), motion.points(around[2], limits)
    turn = _turn(samples) if samples else 0.0
    if min(len(before), len(after)) < 20 or abs(turn) < 0.2:
        yield left_out(check, "too few echoes, or no turn by odometry")
        return
    reach = 1.8 * abs(turn)
    turns = np.arange(-reach, reach, 0.02)
    mismatch = turn_mismatches(before, after, turns)
    seen, best = float(turns[mismatch.argmin()]), float(mismatch.min())
    still = float(mismatch[np.abs(turns).argmin()])
    words = f"{seen:.2f} rad by the scans, {turn:.2f} rad by odometry"
    if best > _CLEARER * still:
        yield note(
            check,
            f"the scans are inconclusive (mismatch {best:.3f} m): {words}",
            "repeat it where the scan has more structure",
        )
    elif seen * turn < 0.0:
        advice = (
            "the lidar is mirrored or upside-down: mount it upright, or let its driver turn the scan (inverted); "
            "where the robot itself turned to the right, motors and encoders are both swapped"
        )
        yield no_go(check, f"the scan turns the wrong way: {words}", advice)
    else:
        yield _scale_finding(check, "odometry", [seen / turn], limits.scale_tolerance)


def check_shift_by_scan(motion: Motion, limits: Limits) -> Iterator[Finding]:
    """Find a lidar that is mounted at another angle than TF says."""
    check, around = "way by scan", motion.around("ahead")
    if around is None:
        return
    samples = motion.odometry(around[0].end - _SETTLED_S, around[2].end)
    before, after = motion.points(around[0], limits), motion.points(around[2], limits)
    way = _way(samples) if samples else 0.0
    if min(len(before), len(after)) < 20 or abs(way) < 0.05:
        yield left_out(check, "too few echoes, or no way by odometry")
        return
    angles = np.radians(np.arange(-180.0, 180.0, 5.0))
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    mismatch = shift_mismatches(before, after, way * directions)
    best, told = int(mismatch.argmin()), float(mismatch[np.abs(angles).argmin()])
    floor = max(float(mismatch[best]), _LEAST_MISMATCH)
    if float(mismatch.max()) * _CLEARER < floor:
        yield note(check, "the scans do not show the direction", "repeat it where the scan has more structure")
    elif abs(angles[best]) > math.radians(20.0) and floor < _CLEARER * told:
        yaw = float(wrap(limits.lidar_yaw - angles[best]))
        words = f"driving ahead moves the scan as if the lidar were turned by {yaw:.2f} rad, not {limits.lidar_yaw:.2f}"
        advice = (
            f"turn the lidar, or start the controllers (and this) with lidar_yaw {yaw:.2f} and correct the URDF; "
            "where the robot itself drove back, motors and encoders are both swapped"
        )
        yield no_go(check, words, advice)
    else:
        yield ok(check, f"the scans move as a lidar turned by {limits.lidar_yaw:.2f} rad sees it")


def _scale_finding(check: str, against: str, ratios: Sequence[float], tolerance: float) -> Finding:
    """Return the finding about ratios that should be 1."""
    worst = max(ratios, key=lambda ratio: abs(ratio - 1.0))
    words = f"{worst:.2f} times {against}"
    if not math.isfinite(worst) or abs(worst) < 0.1:
        return no_go(check, f"{words}: nothing moves", "see to the motors' power and to the emergency stop")
    if worst < 0.0:
        return no_go(check, f"{words}: wrong sign", "motors, encoders or wheels are swapped: see the base's cables")
    if abs(worst - 1.0) > tolerance:
        advice = "see wheel radius and separation in the base's parameters, and whether wheels slip"
        return no_go(check, f"{words}: at most {100 * tolerance:.0f} % apart", advice)
    return ok(check, words)


def _response(motion: Motion, part: Part) -> tuple[float, float]:
    """Return a phase's measured over commanded speed, and the time to reach half of it [s], or inf."""
    axis, command = (0, part.phase.v) if part.phase.v else (1, part.phase.omega)
    samples = motion.odometry(part.begin, part.end)
    values = np.array([each.twist[axis] / command for each in samples])
    passed = np.array([each.times.arrival for each in samples]) - part.begin
    late = values[passed > 0.5 * (part.end - part.begin)]
    if not len(late):
        return math.nan, math.inf
    ratio = float(np.median(late))
    begun = passed[values / ratio > 0.5] if ratio else np.empty(0)
    return ratio, float(begun[0]) if len(begun) else math.inf


def _speed_at_end(motion: Motion, part: Part) -> tuple[float, float] | None:
    """Return the magnitudes of speed [m/s] and turn rate [rad/s] at the end of a part; None without odometry."""
    samples = motion.odometry(part.end - 0.3, part.end)
    return (abs(samples[-1].twist[0]), abs(samples[-1].twist[1])) if samples else None


def _way(samples: Sequence[OdometrySample]) -> float:
    """Return how far ahead of the first pose the last one is [m]."""
    (x, y, yaw), (end_x, end_y, _) = samples[0].pose, samples[-1].pose
    return math.cos(yaw) * (end_x - x) + math.sin(yaw) * (end_y - y)


def _integrated_way(samples: Sequence[OdometrySample]) -> float:
    """Return the integral of the speeds over time [m]."""
    return float(np.trapezoid([each.twist[0] for each in samples], [each.times.stamp for each in samples]))


def _turn(samples: Sequence[OdometrySample]) -> float:
    """Return the turn from the first pose to the last one, less than half a turn [rad]."""
    return float(wrap(samples[-1].pose[2] - samples[0].pose[2]))
