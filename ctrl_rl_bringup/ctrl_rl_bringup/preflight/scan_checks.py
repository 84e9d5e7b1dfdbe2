"""Checks of the scans' content: beams, echoes, and whether they change."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from ctrl_rl_core.sensing import DIRECTIONS, view_scan
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ctrl_rl_bringup.preflight.finding import Finding, Limits, no_go, ok
from ctrl_rl_bringup.preflight.recording import Points, Recording
from ctrl_rl_core import ScanError, ScanGeometry

_FARTHEST = 0.3
"""Distance assumed for an echo without a counterpart [m]."""
_MOST = 250
"""Number of echoes of the second scan to look up, spread evenly; more would not help."""
Array = NDArray[np.float64]


def turn_mismatches(before: Points, after: Points, turns: Array) -> Array:
    """Return the mean distance (n,) [m] between the echoes, if the robot had turned by `turns` (n,) [rad] between.

    Args:
        before: Echoes in the robot's frame before the turn (m, 2) [m].
        after: Echoes after it (k, 2) [m].
        turns: Turns to try (n,), counter-clockwise [rad].
    """
    c, s = np.cos(turns), np.sin(turns)
    x, y = _thinned(after).T
    moved = np.stack((np.outer(c, x) - np.outer(s, y), np.outer(s, x) + np.outer(c, y)), axis=-1)
    return _mismatches(before, moved)


def shift_mismatches(before: Points, after: Points, shifts: Points) -> Array:
    """Return the mean distance (n,) [m] between the echoes, if the robot had moved by `shifts` (n, 2) [m] between.

    Args:
        before: Echoes in the robot's frame before the move (m, 2) [m].
        after: Echoes after it (k, 2) [m].
        shifts: Moves to try, in the robot's frame (n, 2) [m].
    """
    return _mismatches(before, _thinned(after)[None, :, :] + shifts[:, None, :])


def _thinned(points: Points) -> Points:
    return points[:: len(points) // _MOST + 1]


def _mismatches(before: Points, moved: NDArray[np.float64]) -> Array:
    """Return the mean distance (n,) [m] from each set of echoes (n, k, 2) to the nearest ones before (m, 2)."""
    distance, _ = KDTree(before).query(moved, distance_upper_bound=_FARTHEST)
    return np.asarray(np.minimum(distance, _FARTHEST).mean(axis=1))


_AHEAD = np.arange(-30, 31) * DIRECTIONS // 360
"""Directions of the cone ahead of the robot that must hold an echo."""
_FEWEST, _ALWAYS, _WITHIN = 5, 0.8, 0.95
"""Minimum number of scans, fraction of them in which a beam hits the robot, and fraction of its radius to count."""


def check_beams(heard: Recording, limits: Limits) -> Iterator[Finding]:
    """Find scans with impossible or contradictory geometry, and lidars that see too little."""
    if not heard.scans:
        return
    check = "beams"
    for scan in heard.scans:
        try:
            scan.geometry.check()
        except ScanError as error:
            yield no_go(check, str(error), "the lidar's driver is set up for another lidar: see its model parameter")
            return
    last = heard.scans[-1].geometry
    counts = [scan.geometry.beams for scan in heard.scans]
    field = math.degrees(abs(last.angle_increment) * last.beams)
    count = f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
    first = math.degrees(last.angle_min)
    words = f"{count} beams over {field:.0f} deg from {first:.0f} deg, {last.range_min:g} to {last.range_max:g} m"
    if field < limits.field:
        yield no_go(check, f"{words}: at least {limits.field:g} deg are needed", "use another lidar, or --field")
    else:
        yield ok(check, words)


def check_echoes(heard: Recording, limits: Limits) -> Iterator[Finding]:
    """Find scans without echoes: a lidar that is dead or covered, or that stands in the open."""
    views, ranges = [], []
    for scan in heard.scans:
        turned = scan.geometry.turned(limits.lidar_yaw)
        try:
            views.append(view_scan(scan.ranges, turned, math.inf, limits.lidar_x))
        except ScanError:
            continue  # `check_beams` says so
        ranges.append(scan.ranges)
    if not views:
        return
    share = float(np.median([view.share for view in views]))
    each = np.concatenate(ranges)
    parts = {"NaN": np.isnan(each), "infinite": np.isinf(each), "zero": each == 0.0, "negative": each < 0.0}
    others = ", ".join(f"{100 * part.mean():.0f} % {name}" for name, part in parts.items() if part.any())
    words = f"{100 * share:.0f} % of the beams have an echo" + (f" ({others})" if others else "")
    if share < limits.echo_share:
        advice = "uncover and clean the lidar, see whether it turns; in the open no lidar policy can drive"
        yield no_go("echoes", f"{words}: at least {100 * limits.echo_share:.0f} % are needed", advice)
        return
    ahead = np.any([view.seen[_AHEAD] for view in views], axis=0)
    field = np.any([view.field[_AHEAD] for view in views], axis=0)
    if not field.any():
        yield no_go("echoes", f"{words}; the lidar does not look ahead", "turn it, or tell --lidar-yaw")
    elif not ahead.any():
        yield no_go("echoes", f"{words}; none within 30 deg ahead", "uncover the lidar, or put something ahead of it")
    else:
        yield ok("echoes", words)


def check_frozen(heard: Recording, _limits: Limits) -> Iterator[Finding]:
    """Find a lidar that repeats the same scan; real noise never repeats."""
    contents = [scan.ranges.tobytes() for scan in heard.scans]
    if len(contents) < 2:
        return
    repeated = sum(before == after for before, after in pairwise(contents))
    if repeated == len(contents) - 1 or repeated > max(2, len(contents) // 4):
        advice = "start the lidar's driver again; a simulated lidar needs noise to pass"
        yield no_go("scan changes", f"{repeated} of {len(contents)} scans are the same as the one before", advice)
    else:
        yield ok("scan changes", f"{len(contents) - repeated} different scans")


def check_own_body(heard: Recording, limits: Limits) -> Iterator[Finding]:
    """Find beams that always hit the robot itself: a cable, a post, a misplaced lidar."""
    check = "own body"
    scans = [scan for scan in heard.scans if not _is_wrong(scan.geometry)]
    if len(scans) < _FEWEST or limits.robot_radius <= 0.0:
        return
    inside = np.zeros((len(scans), DIRECTIONS), dtype=bool)
    for row, scan in zip(inside, scans, strict=True):
        points = scan.points(limits.lidar_x, limits.lidar_yaw)
        near = points[np.hypot(*points.T) < _WITHIN * limits.robot_radius]
        bearings = np.degrees(np.arctan2(near[:, 1], near[:, 0] - limits.lidar_x))
        row[np.rint(bearings * (DIRECTIONS / 360.0)).astype(int) % DIRECTIONS] = True
    always = np.flatnonzero(inside.mean(axis=0) >= _ALWAYS)
    if not len(always):
        yield ok(check, "no beam meets the robot itself")
        return
    words = f"beams at {always[0]} to {always[-1]} deg always see the robot itself, within {limits.robot_radius:g} m"
    advice = "clear the lidar's view, mask these beams (laser_filters), or correct --lidar-x, --robot-radius or --robot"
    yield no_go(check, words, advice)


def _is_wrong(geometry: ScanGeometry) -> bool:
    try:
        geometry.check()
    except ScanError:
        return True
    return False
