"""Convert worlds of the benchmark into tasks of this suite."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ctrl_rl_core import Box, Disc, NavigationTask, Shape, find_robot
from ctrl_rl_trials.barn.plugin_file import read_keyframes
from ctrl_rl_trials.barn.world_file import WorldFile, read_path, read_world
from ctrl_rl_trials.errors import TrialError

STATIC, MOVING = 300, 60
"""Numbers of worlds; the moving ones follow the static ones, as in the challenge."""
LIMIT = 100.0
"""Time limit for reaching the goal, from the first motion [s]."""
REACHED = 1.0
"""Distance from the goal within which it counts as reached [m]."""
_ROOM = 15.0
"""Free space between the task's outer walls and start, goal and obstacles [m]."""
_SPARE = 60.0


@dataclass(frozen=True)
class Scenario:
    """One world of the benchmark.

    Attributes:
        number: Number of the world in the challenge.
        task: Task with world, robot, start and goal.
        content: Content of the task file.
        start: Start pose x, y, theta (3,) [m, m, rad].
        goal: Position of the goal [m].
        length: Length of the optimal path [m].
    """

    number: int
    task: NavigationTask
    content: dict[str, Any]
    start: tuple[float, float, float]
    goal: tuple[float, float]
    length: float


def load_scenario(folder: Path, number: int) -> Scenario:
    """Read one world of the challenge's repository.

    Args:
        folder: Folder of the repository, or its jackal_helper.
        number: 0 to 299 for BARN, 300 to 359 for DynaBARN.

    Raises:
        TrialError: A file is missing or wrong, or there is no such number.
    """
    if not 0 <= number < STATIC + MOVING:
        raise TrialError(f"world {number}: there are 0 to {STATIC + MOVING - 1}")
    root = folder / "jackal_helper" if (folder / "jackal_helper").is_dir() else folder
    if not (root / "worlds").is_dir():
        raise TrialError(f"{folder}: has no folder worlds: give a checkout of the-barn-challenge")
    if number < STATIC:
        world = read_world(root / "worlds" / "BARN" / f"world_{number}.world")
        start, goal = (-2.25, 3.0, 0.5 * math.pi), (-2.25, 13.0)
        places = read_path(root / "worlds" / "BARN" / "path_files" / f"path_{number}.npy")
        way = np.concatenate(([start[:2]], places, [goal]))
        length = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
    else:
        world = read_world(root / "worlds" / "DynaBARN" / f"world_{number - STATIC}.world")
        start, goal = (11.0, 0.0, math.pi), (-9.0, 0.0)
        length = math.dist(start[:2], goal)
    content = _content(number, world, root / "plugins", start, goal)
    return Scenario(number, NavigationTask.model_validate(content), content, start, goal, length)


def _content(
    number: int, world: WorldFile, plugins: Path, start: tuple[float, float, float], goal: tuple[float, float]
) -> dict[str, Any]:
    """Return the content of a task file: a Jackal with the challenge's lidar."""
    shapes: list[Shape] = [*world.cylinders, *world.boxes]
    places = np.array([start[:2], goal, *(shape.centre for shape in shapes)])
    (left, bottom), (right, top) = (places.min(axis=0) - _ROOM).tolist(), (places.max(axis=0) + _ROOM).tolist()
    jackal = find_robot("jackal")
    turns = f"{-jackal.turn_rate} .. {jackal.turn_rate} rad/s"
    content: dict[str, Any] = {
        "name": f"barn_{number}",
        "kind": "navigation",
        "about": "A Jackal drives through a world of the BARN challenge.",
        "source": f"BARN challenge, world {number}",
        "system": {"model": "dubins_car", "controls": {"v": f"{jackal.speed} m/s", "omega": turns}},
        "robot": {"body": "jackal", "commands": {"v": f"-0.5 .. {jackal.speed} m/s", "omega": turns}},
        "arena": {"x": f"{left} .. {right} m", "y": f"{bottom} .. {top} m", "wall_thickness": "0.2 m"},
        "start": {"x": f"{start[0]} m", "y": f"{start[1]} m", "theta": f"{start[2]} rad"},
        "goal": {"disc": {"centre": f"({goal[0]}, {goal[1]}) m", "radius": f"{REACHED} m"}},
        "obstacles": [_obstacle(shape) for shape in shapes],
        "episode": {"steps": round((LIMIT + _SPARE) / 0.05), "time_step": "0.05 s"},
        "rewards": {"goal": 1, "collision": -1},
        "lidar": {
            "beams": 720,
            "field": "-135.0 .. 135.0 deg",
            "range": "0.06 .. 10.0 m",
            "rate": "40.0 Hz",
            "noise": "0.01 m",
        },
    }
    if world.moving:
        content["movers"] = [_mover(plugins / each.plugin, each.radius) for each in world.moving]
    return content


def _obstacle(shape: Shape) -> dict[str, Any]:
    centre = f"({shape.centre[0]}, {shape.centre[1]}) m"
    if isinstance(shape, Disc):
        return {"disc": {"centre": centre, "radius": f"{shape.radius} m"}}
    return {"box": {"centre": centre, "size": f"({_along_axes(shape)[0]}, {_along_axes(shape)[1]}) m"}}


def _along_axes(box: Box) -> tuple[float, float]:
    """Return the side lengths of a box that is rotated by a multiple of 90 degrees.

    Raises:
        TrialError: The box has another rotation.
    """
    quarters = box.angle / (0.5 * math.pi)
    if abs(quarters - round(quarters)) > 1e-3:
        raise TrialError(
            f"a box at ({box.centre[0]:g}, {box.centre[1]:g}) m is rotated: a task's boxes must be parallel to the axes"
        )
    return box.size if round(quarters) % 2 == 0 else (box.size[1], box.size[0])


def _mover(plugin: Path, radius: float) -> dict[str, Any]:
    motion = read_keyframes(plugin)
    frames = [
        {"time": f"{time:.6f} s", "point": f"({x:.6f}, {y:.6f}) m"}
        for time, (x, y) in zip(motion.times, motion.points, strict=True)
    ]
    return {"radius": f"{radius} m", "keyframes": {"frames": frames, "repeat": True}}
