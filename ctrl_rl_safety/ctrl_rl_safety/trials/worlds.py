"""Random rooms for adversaries, and the tasks of policies with a lidar suitable for the filter."""

from __future__ import annotations

from typing import Any

import numpy as np
from ctrl_rl_core.tasks import MoverSpec

from ctrl_rl_core import Interval, NavigationTask, find_robot
from ctrl_rl_safety.models.robot_model import RobotModel

PLACES = ("boxes", "movers")
MOVER_SPEED = 0.4
"""Maximum speed of movers, known to the filter [m/s]."""
_HALVES = {"boxes": (2.5, 2.0), "movers": (3.0, 2.5)}
_STARTS = {"boxes": 0.0, "movers": 0.6}
"""Half the side length of the square of the robot's starts, since a mover may start at the centre [m]."""
_BOXES = {"boxes": 9, "movers": 6}
_MOVERS = {"boxes": 0, "movers": 2}
_LIDAR = {"beams": 360, "field": "0.0 .. 360.0 deg", "range": "0.1 .. 8.0 m", "rate": "5.0 Hz", "noise": "0.01 m"}
_LONGEST_S = 15.0
_AROUND = 360
"""Number of beams of the filter's 360 degree lidar."""
_WANDER = {"radius": "0.2 m", "wander": {"points": 12, "speed": f"0.1 .. {MOVER_SPEED} m/s"}}
_ATTACKED = 1_000_000
"""Seed of the room in which attackers are trained, not used in trials."""


def room(place: str, body: str, model: RobotModel, seed: int) -> NavigationTask:
    """Create a room with random boxes, and two wanderers if the place has movers.

    Args:
        place: One of `PLACES`.
        body: Body of the robot, as in a task file.
        model: Constants that bound the commands.
        seed: Seed of the boxes.
    """
    random, half, start = np.random.default_rng((seed, 7)), _HALVES[place], _STARTS[place]
    free = find_robot(body).radius + 1.5 * start + 0.65
    boxes: list[dict[str, Any]] = []
    while len(boxes) < _BOXES[place]:
        x, y = random.uniform(-half[0], half[0]), random.uniform(-half[1], half[1])
        if np.hypot(x, y) < free:  # the robot starts near the centre
            continue
        sides = random.uniform(0.15, 0.6, 2)
        size = f"({sides[0]:.3f}, {sides[1]:.3f}) m"
        boxes.append({"box": {"centre": f"({x:.3f}, {y:.3f}) m", "size": size}})
    content = {
        "name": f"room_of_{place}",
        "kind": "navigation",
        "about": "A robot that an adversary drives in a room.",
        "source": "drawn from a seed",
        "system": {"model": "dubins_car"},
        "robot": {
            "body": body,
            "commands": {
                "v": f"{-model.reverse_speed} .. {model.speed} m/s",
                "omega": f"{-model.turn_rate} .. {model.turn_rate} rad/s",
            },
        },
        "arena": {"x": f"{-half[0]} .. {half[0]} m", "y": f"{-half[1]} .. {half[1]} m", "wall_thickness": "0.1 m"},
        "start": {"x": f"{-start} .. {start} m", "y": f"{-start} .. {start} m", "theta": "-180.0 .. 180.0 deg"},
        "goal": {"x": "100.0 m"},
        "obstacles": boxes,
        "movers": [_WANDER] * _MOVERS[place],
        "episode": {"steps": round(_LONGEST_S / 0.2), "time_step": "0.2 s"},
        "rewards": {"goal": 0, "collision": 0},
        "lidar": _LIDAR,
    }
    return NavigationTask.model_validate(content)


def attacked_room(body: str, model: RobotModel) -> NavigationTask:
    """Create the room with movers for training attackers, with a lidar of 24 beams for their policies."""
    task = room("movers", body, model, _ATTACKED)
    lidar = task.lidar.model_copy(update={"beams": 24, "noise": 0.0})
    return task.model_copy(update={"lidar": lidar})


def with_whole_scan(task: NavigationTask, rate: float = 0.0) -> NavigationTask:
    """Return a task with a 360 degree lidar of 360 beams, which the filter needs.

    A policy with fewer beams uses those at its own bearings.

    Args:
        task: Task of a policy.
        rate: Scans per second [Hz]; 0 for the task's own.
    """
    changes: dict[str, Any] = {"rate": rate} if rate else {}
    if task.lidar.beams < _AROUND:
        changes |= {"beams": _AROUND, "field": Interval(-np.pi, np.pi), "placement": "edges", "noise": 0.01}
    return task.model_copy(update={"lidar": task.lidar.model_copy(update=changes)})


def with_movers(task: NavigationTask, count: int) -> NavigationTask:
    """Return a task with this many additional movers that wander in its arena."""
    if not count:
        return task
    return task.model_copy(update={"movers": (*task.movers, *[MoverSpec.model_validate(_WANDER)] * count)})
