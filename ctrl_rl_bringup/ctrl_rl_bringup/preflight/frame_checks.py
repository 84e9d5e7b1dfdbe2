"""Checks of frames: names by REP-105, the tree, and where TF places the lidar."""

from __future__ import annotations

import math
from collections.abc import Iterator

from ctrl_rl_core.tasks import wrap

from ctrl_rl_bringup.preflight.finding import Finding, Limits, left_out, no_go, note, ok
from ctrl_rl_bringup.preflight.frames import planar_pose
from ctrl_rl_bringup.preflight.recording import Recording

_BASES = ("base_footprint", "base_link")
_STATE_PUBLISHER = "start robot_state_publisher with the robot's URDF (turtlebot3_bringup robot.launch.py does)"


def check_names(heard: Recording, _limits: Limits) -> Iterator[Finding]:
    """Find frames whose names violate REP-105, and messages without a frame."""
    if not (heard.odometry and heard.scans):
        return
    odom, base, scan = heard.odometry[-1].frame, heard.odometry[-1].child, heard.scans[-1].frame
    empty = [name for name, frame in (("odom", odom), ("odom child", base), ("scan", scan)) if not frame]
    if empty:
        yield no_go("frame names", f"{', '.join(empty)} has no frame", "set the frame_id parameters of its driver")
        return
    words = f"{odom} -> {base}, scan in {scan}"
    odd = [frame for frame in (odom, base, scan) if frame.startswith("/")]
    if odd:
        yield note("frame names", f"{words}: {', '.join(odd)} begins with /", "ROS 2 knows no such frames: drop the /")
    elif odom.rpartition("/")[2] != "odom" or base.rpartition("/")[2] not in _BASES:
        yield note("frame names", words, f"REP-105 names them odom and {' or '.join(_BASES)}")
    else:
        yield ok("frame names", words)


def check_tree(heard: Recording, limits: Limits) -> Iterator[Finding]:
    """Find frames outside the tree, with two parents, or out of date."""
    if heard.frames is None:
        yield left_out("frame tree", "tf2_msgs is not installed here")
        return
    if not (heard.odometry and heard.scans):
        return
    names = (heard.odometry[-1].frame, heard.odometry[-1].child, heard.scans[-1].frame)
    odom, base, scan = (name.lstrip("/") for name in names)
    tree = heard.frames
    torn = sorted({link.child for link in tree if len(tree.parents(link.child)) > 1})
    if torn:
        parents = " and ".join(tree.parents(torn[0]))
        advice = "two nodes publish the transform: end one (or publish_tf:=false)"
        yield no_go("frame tree", f"frame {torn[0]} has two parents: {parents}", advice)
    elif tree.conflict:
        yield no_go("frame tree", tree.conflict, "two nodes publish the transform: end one (or publish_tf:=false)")
    elif tree.between(base, scan) is None:
        yield no_go("frame tree", f"no transform from {base} to {scan}", _STATE_PUBLISHER)
    elif tree.between(odom, base) is None:
        advice = "let the odometry publish it (diff_drive's odom TF), or an EKF"
        yield no_go("frame tree", f"no transform from {odom} to {base}", advice)
    else:
        moving = tree.link(odom, base)
        age = 0.0 if moving is None else moving.age
        if age > limits.largest_age or age < -limits.largest_lead:
            advice = "set the clocks of robot and computer by one server"
            words = f"{age:.2f} s behind" if age > 0.0 else f"{-age:.2f} s ahead of"
            yield no_go("frame tree", f"{odom} -> {base} is {words} the clock", advice)
        else:
            yield ok("frame tree", f"{odom} -> {base} -> {scan}")


def check_odometry_agrees(heard: Recording, _limits: Limits) -> Iterator[Finding]:
    """Find odometry whose message and transform disagree."""
    if heard.frames is None or not heard.odometry:
        return
    last = heard.odometry[-1]
    pose = heard.frames.between(last.frame.lstrip("/"), last.child.lstrip("/"))
    if pose is None:
        return
    x, y, yaw = planar_pose(pose)
    distance, turn = math.hypot(x - last.pose[0], y - last.pose[1]), abs(float(wrap(yaw - last.pose[2])))
    if distance > 0.1 or turn > 0.2:
        words = f"/tf and {heard.topic('odom').name} differ by {distance:.2f} m and {turn:.2f} rad"
        yield no_go("odometry and TF", words, "two sources of odometry: let only one publish odom -> base")
    else:
        yield ok("odometry and TF", f"/tf and {heard.topic('odom').name} agree")


def check_mounting(heard: Recording, limits: Limits) -> Iterator[Finding]:
    """Find a lidar that TF places upside-down, or elsewhere than the controllers' parameters."""
    if heard.frames is None or not (heard.odometry and heard.scans):
        return
    pose = heard.frames.between(heard.odometry[-1].child.lstrip("/"), heard.scans[-1].frame.lstrip("/"))
    if pose is None:
        return
    x, y, yaw = planar_pose(pose)
    words = f"by TF {x:.3f} m ahead, turned by {yaw:.2f} rad"
    if float(pose[2, 2]) < 0.9:
        advice = "mount it upright, or let its driver turn the scan (inverted, reversion) and correct the URDF"
        yield no_go("lidar mounting", f"{words}, but tilted or upside-down", advice)
    elif abs(float(wrap(yaw - limits.lidar_yaw))) > limits.lidar_yaw_tolerance:
        advice = f"start the controllers (and this) with lidar_yaw {yaw:.4f}, or correct the URDF"
        yield no_go("lidar mounting", f"{words}; the controllers are told {limits.lidar_yaw:.2f} rad", advice)
    elif abs(x - limits.lidar_x) > limits.lidar_x_tolerance or abs(y) > limits.lidar_x_tolerance:
        advice = f"start the controllers (and this) with lidar_x {x:.3f}, or correct the URDF"
        yield no_go("lidar mounting", f"{words}, {y:.3f} m aside; they are told {limits.lidar_x:.3f} m ahead", advice)
    else:
        yield ok("lidar mounting", words)
