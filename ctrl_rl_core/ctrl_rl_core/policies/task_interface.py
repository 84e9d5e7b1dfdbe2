"""The interface of a policy trained in a navigation task, matching the observation of `sim_bridge.environments`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.policies.manifest import PolicyManifest
from ctrl_rl_core.robots.robot import COMMANDS
from ctrl_rl_core.tasks.task import NavigationTask

SPEED_RANGE = (-20.0, 20.0)
"""Clipping range of flight speeds [m/s]."""
TURN_RANGE = (-60.0, 60.0)
"""Clipping range of turn rates [rad/s]."""
POSITION_MARGIN = 5.0
"""Margin around the arena or corridor within which positions are distinguished [m]."""


def state_ranges(task: NavigationTask) -> dict[str, tuple[float, float]]:
    """Return the minimum and maximum of each observed state component, in SI units."""
    ranges = {"theta": (-math.pi, math.pi), "psi": (-math.pi, math.pi), "omega": TURN_RANGE}
    ranges |= dict.fromkeys(("v", "v_x", "v_z"), SPEED_RANGE)
    if task.corridor is None:
        sides = {name: (side.low, side.high) for name, side in task.plane_bounds.items()}
    else:
        path = task.corridor.path
        points = path.pose(np.linspace(0.0, path.length, 200))
        sides = {name: (points[:, axis].min(), points[:, axis].max()) for axis, name in enumerate(("x", "y"))}
    ranges |= {name: (low - POSITION_MARGIN, high + POSITION_MARGIN) for name, (low, high) in sides.items()}
    own = {state.name: (state.lower, state.upper) for state in task.system.build().states}
    return {name: ranges[name] if name in ranges else _finite(own[name]) for name in task.observed_states}


def _finite(bounds: tuple[float, float]) -> tuple[float, float]:
    """Return the bounds of a component of a custom model, or the speed range if it has none."""
    return bounds if np.isfinite(bounds).all() else SPEED_RANGE


def interface_of(task: NavigationTask) -> PolicyManifest:
    """Return the interface of a task's policies; observation scaling is done by the network itself.

    Raises:
        PolicyError: The robot's commands cannot be sent by a node.
    """
    if tuple(task.robot.commands) not in COMMANDS.values():
        raise PolicyError(f"task '{task.name}': no node can send {' and '.join(task.robot.commands)}")
    flies = task.plane == "xz"
    ranges = state_ranges(task)
    parts: list[dict[str, Any]] = []
    for name, (low, high) in ranges.items():
        source = "pose" if not flies and name in ("x", "y", "theta") else "odometry"
        if not parts or parts[-1]["source"] != source:
            parts.append({"source": source, "names": [], "low": [], "high": []})
        for key, value in (("names", name), ("low", float(low)), ("high", float(high))):
            parts[-1][key].append(value)
    lidar, commands = task.lidar, list(task.robot.commands.values())
    yaw = 0.0 if task.robot.robot is None else task.robot.robot.lidar.yaw
    scan = {"source": "scan", "count": lidar.beams, "first": lidar.angle_min + yaw, "step": lidar.angle_increment}
    parts.append({**scan, "low": lidar.range.low, "high": lidar.range.high})
    content: dict[str, Any] = {
        "robot": "planar_quadrotor" if flies else "differential_drive",
        "period": task.episode.time_step,
        "observation": parts,
        "action": {"low": [each.low for each in commands], "high": [each.high for each in commands]},
        "about": task.about,
    }
    if flies:
        parameters = task.system.build().parameters
        content["rest"] = [0.5 * parameters["m"] * parameters["g"]] * 2
    try:
        return PolicyManifest.model_validate(content)
    except ValueError as error:
        raise PolicyError(f"task '{task.name}': no node can send its commands: {error}") from None
