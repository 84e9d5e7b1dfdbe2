"""Checks of a standing robot: its odometry, its battery, and whether map and pose agree with the scan."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from ctrl_rl_core.navigation import OCCUPIED

from ctrl_rl_bringup.preflight.finding import Finding, Limits, left_out, no_go, note, ok
from ctrl_rl_bringup.preflight.frames import planar_pose
from ctrl_rl_bringup.preflight.recording import Points, Recording
from ctrl_rl_core import OccupancyMap

STANDS = (0.02, 0.05)
"""Speed [m/s] and turn rate [rad/s] up to which a robot stands."""


def check_odometry(heard: Recording, _limits: Limits) -> Iterator[Finding]:
    """Find odometry that is not finite or has no attitude, and a robot that moves undriven."""
    if not heard.odometry:
        return
    faults = [each.fault for each in heard.odometry if each.fault]
    if faults:
        words = f"{len(faults)} of {len(heard.odometry)} messages are refused: {faults[-1]}"
        yield no_go("odometry", words, "start the robot's base again; see its IMU and wheel encoders")
        return
    v, omega = np.abs([each.twist for each in heard.odometry]).max(axis=0)
    first, last = heard.odometry[0].pose, heard.odometry[-1].pose
    way = math.hypot(last[0] - first[0], last[1] - first[1])
    if v > STANDS[0] or omega > STANDS[1] or way > 0.05:
        words = f"the robot moves: {v:.2f} m/s, {omega:.2f} rad/s, {way:.2f} m in {heard.end - heard.begin:.0f} s"
        yield no_go("odometry", words, "end what drives it; if it stands, its odometry is wrong: start its base again")
    else:
        yield ok("odometry", f"the robot stands, {len(heard.odometry)} finite messages")


def check_battery(heard: Recording, limits: Limits) -> Iterator[Finding]:
    """Find an empty battery; many drivers report only its voltage."""
    if heard.battery is None:
        name = heard.topic("battery_state").name
        yield note("battery", f"nothing on {name}", "look at the battery yourself: a burger's LiPo needs 11 V and more")
        return
    charge, voltage = heard.battery
    told = []
    if math.isfinite(charge) and charge > 0.0:
        told.append((f"{100 * charge:.0f} %", charge >= limits.least_charge))
    if math.isfinite(voltage) and voltage > 0.0:
        told.append((f"{voltage:.1f} V", voltage >= limits.least_voltage))
    words = ", ".join(word for word, _ in told)
    if not told:
        yield note("battery", "its driver reports neither charge nor voltage", "look at the battery yourself")
    elif not all(enough for _, enough in told):
        least = f"{100 * limits.least_charge:.0f} % and {limits.least_voltage:g} V"
        advice = "charge or change it; a battery of another kind: --least-voltage"
        yield no_go("battery", f"{words}: at least {least} are needed", advice)
    else:
        yield ok("battery", words)


def check_map(heard: Recording, limits: Limits) -> Iterator[Finding]:
    """Find a map or pose that disagrees with the scan."""
    check = "map and pose"
    if heard.map_fault:
        yield no_go(check, heard.map_fault, "let map_server load another map")
        return
    if heard.map is None:
        yield left_out(check, f"nobody publishes {heard.topic('map').name}")
        return
    if not (heard.scans and heard.odometry):
        return
    frame, grid = heard.map
    pose = _pose_in(frame, heard)
    if pose is None:
        advice = "start the localisation (amcl, slam_toolbox) and give it the initial pose"
        yield no_go(check, f"no pose of {heard.odometry[-1].child} in {frame}", advice)
        return
    share = near_share(grid, heard.scans[-1].points(limits.lidar_x, limits.lidar_yaw), pose, limits.map_distance)
    words = f"{100 * share:.0f} % of the echoes lie within {limits.map_distance:g} m of the map's walls"
    if share < limits.map_share:
        advice = "give the initial pose again (2D Pose Estimate), or load the map of this room"
        yield no_go(check, f"{words}: at least {100 * limits.map_share:.0f} % are needed", advice)
    else:
        yield ok(check, words)


def near_share(grid: OccupancyMap, points: Points, pose: tuple[float, float, float], distance: float) -> float:
    """Return the share of echoes, 0 to 1, that lie near an occupied cell.

    Args:
        grid: Map in whose frame the pose is.
        points: Echoes in the robot's frame (n, 2) [m].
        pose: x, y, yaw of the robot in the map [m, m, rad].
        distance: Distance up to which an echo is near [m].
    """
    if not len(points) or not (grid.cells == OCCUPIED).any():
        return 0.0
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    rows, columns = grid.world_to_cell(points @ np.array(((c, s), (-s, c))) + (x, y))
    height, width = grid.cells.shape
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    near = grid.clearance(unknown_is_free=True)[rows[inside], columns[inside]] <= distance
    return float(np.count_nonzero(near)) / len(points)


def _pose_in(frame: str, heard: Recording) -> tuple[float, float, float] | None:
    """Return x, y, yaw of the robot in a frame [m, m, rad], from TF or amcl_pose, or None."""
    base = heard.odometry[-1].child.lstrip("/")
    matrix = heard.frames.between(frame.lstrip("/"), base) if heard.frames is not None else None
    if matrix is not None:
        return planar_pose(matrix)
    if heard.map_pose is not None and heard.map_pose[0].lstrip("/") == frame.lstrip("/"):
        return heard.map_pose[1]
    return None
