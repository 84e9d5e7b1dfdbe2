"""A room of boxes with a door: what a lidar sees in it, and how near a robot is to it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_safety import RobotModel

Array = NDArray[np.float64]

BEARINGS = np.radians(np.arange(0.0, 360.0, 0.5))
"""Bearings of the lidar's beams in the robot's frame (n,) [rad]."""
_REACH, _NOISE, _MOST_SIGMAS = 8.0, 0.01, 2.5
_BACK, _FRONT, _SIDE, _WALL = -4.5, 5.0, 3.0, 0.05


def room_with_door(width: float, thickness: float) -> Array:
    """Return boxes as centres and half sides (n, 4) [m]: a wall across x = 0 with a gap around y = 0, in a closed room.

    Args:
        width: Width of the gap [m].
        thickness: Thickness of the wall, which lies behind x = 0 [m].
    """
    post = 0.5 * (_SIDE - 0.5 * width)
    across, along = 0.5 * (_FRONT + _BACK), 0.5 * (_FRONT - _BACK)
    boxes = [(0.5 * thickness, side * (_SIDE - post), 0.5 * thickness, post) for side in (-1.0, 1.0)]
    boxes += [(across, side * _SIDE, along, _WALL) for side in (-1.0, 1.0)]
    boxes += [(x, 0.0, _WALL, _SIDE) for x in (_BACK, _FRONT)]
    return np.array(boxes)


def look(state: Array, boxes: Array, random: np.random.Generator) -> Array:
    """Return the ranges of a scan (n,), infinite without an echo [m]."""
    along = np.column_stack((np.cos(BEARINGS + state[2]), np.sin(BEARINGS + state[2])))[:, None]
    along = np.where(np.abs(along) < 1e-12, 1e-12, along)
    middle, half = (boxes[:, :2] - state[:2]) / along, boxes[:, 2:] / np.abs(along)
    enters, leaves = (middle - half).max(axis=2), (middle + half).min(axis=2)
    ranges = np.where((enters <= leaves) & (enters > 0.0), enters, np.inf).min(axis=1)
    ranges[ranges > _REACH] = np.inf
    return np.asarray(ranges + _NOISE * np.clip(random.standard_normal(len(ranges)), -_MOST_SIGMAS, _MOST_SIGMAS))


def clearance(state: Array, boxes: Array, model: RobotModel) -> float:
    """Return the distance from the robot to the nearest box [m]; less than 0 where they overlap.

    Two convex shapes are nearest to each other at a corner of one of them.
    """
    c, s = math.cos(state[2]), math.sin(state[2])
    if not model.length:
        return float(_outside(state[:2] - boxes[:, :2], boxes[:, 2:]).min()) - model.radius
    signs = np.array(((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)))
    own = state[:2] + (signs * model.core) @ np.array(((c, s), (-s, c)))
    others = (boxes[:, None, :2] + signs * boxes[:, None, 2:]).reshape(-1, 2)
    to_boxes = _outside(own[:, None] - boxes[:, :2], boxes[:, 2:])
    to_robot = _outside((others - state[:2]) @ np.array(((c, -s), (s, c))), np.array(model.core))
    return float(min(to_boxes.min(), to_robot.min()))


def _outside(places: Array, half: Array) -> Array:
    """Return the distances of places (..., 2) to a box around the origin, less than 0 inside [m]."""
    over = np.abs(places) - half
    return np.asarray(np.hypot(*np.moveaxis(np.maximum(over, 0.0), -1, 0)) + np.minimum(over.max(axis=-1), 0.0))
