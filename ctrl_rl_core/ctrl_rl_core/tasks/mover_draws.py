"""Random motions of a task's moving obstacles in one episode, within the limits of its file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.geometry.motion import Motion, polyline
from ctrl_rl_core.geometry.shapes import World
from ctrl_rl_core.tasks.schema.movers import MoverSpec, TrackSpec, WanderSpec
from ctrl_rl_core.tasks.task import NavigationTask, TaskError

Array = NDArray[np.float64]
_TRIES = 500
"""Maximum number of draws of one track, or of one waypoint of a wanderer."""
_STEP = 0.02
"""Spacing of the checked positions along a path [m]."""


@dataclass(frozen=True)
class MoverPlan:
    """One mover in one episode.

    Attributes:
        radius: Radius of the cylinder [m].
        motion: Positions over the time since its start.
        delay: Start delay [s].
        near: Distance between a robot's centre and its own that triggers the start [m]; None to start at once.
        yields: Minimum distance to robots, for which the mover waits [m]; None to never wait.
    """

    radius: float
    motion: Motion
    delay: float
    near: float | None
    yields: float | None


def draw_movers(task: NavigationTask, world: World, random: np.random.Generator) -> tuple[MoverPlan, ...]:
    """Draw the movers of one episode, in the order of the task file.

    Tracks and wanderers keep clear of walls and obstacles, but ignore each other.

    Args:
        task: Task with the movers.
        world: Walls and obstacles.
        random: Random generator of points, speeds and delays.

    Raises:
        TaskError: No path of a mover is clear of walls and obstacles.
    """
    return tuple(_draw(task, number, spec, world, random) for number, spec in enumerate(task.movers))


def _draw(task: NavigationTask, number: int, spec: MoverSpec, world: World, random: np.random.Generator) -> MoverPlan:
    delay = float(random.uniform(*spec.delay))
    if spec.keyframes is not None:
        motion: Motion | None = spec.keyframes.motion
    elif spec.wander is not None:
        motion = _wander(task, spec.wander, spec.radius, world, random)
    else:
        assert spec.track is not None
        motion = _track(spec.track, spec.radius, world, random)
    if motion is None:
        raise TaskError(
            f"task '{task.name}': movers.{number} finds no way that is clear of walls and obstacles: "
            f"make it smaller than {spec.radius:g} m, or move its points"
        )
    return MoverPlan(spec.radius, motion, delay, spec.near, spec.yields)


def _track(spec: TrackSpec, radius: float, world: World, random: np.random.Generator) -> Motion | None:
    speed = float(random.uniform(*spec.speed))
    for _ in range(_TRIES if spec.spread else 1):
        reach = spec.spread * np.sqrt(random.uniform(size=len(spec.points)))
        angle = random.uniform(-np.pi, np.pi, len(spec.points))
        points = spec.points + np.column_stack((reach * np.cos(angle), reach * np.sin(angle)))
        if world.path is not None:
            points = _from_path(world, points, spec.repeat == "loop")
        way = np.concatenate((points, points[:1])) if spec.repeat == "loop" else points
        if _clear(way, radius, world):
            return polyline(points, speed, spec.repeat)
    return None


def _wander(
    task: NavigationTask, spec: WanderSpec, radius: float, world: World, random: np.random.Generator
) -> Motion | None:
    speed = float(random.uniform(*spec.speed))
    (left, right), (low, high) = task.plane_bounds.values()
    points: list[Array] = []
    for _ in range(_TRIES * spec.points):
        point = random.uniform((left, low), (right, high))
        if _clear(np.stack((points[-1] if points else point, point)), radius, world):
            points.append(point)
        if len(points) == spec.points:
            return polyline(points, speed, "back_and_forth")
    return None


def _from_path(world: World, points: Array, closed: bool) -> Array:
    """Return closely spaced positions (m, 2) [m] along straight lines in path coordinates."""
    assert world.path is not None
    corners = np.concatenate((points, points[:1])) if closed else points
    along, lateral = _between(corners).T
    x, y, heading = world.path.pose(along).T
    return np.column_stack((x - lateral * np.sin(heading), y + lateral * np.cos(heading)))


def _clear(points: Array, radius: float, world: World) -> bool:
    """Return whether a disc stays clear of walls and obstacles on straight lines between points (n, 2) [m]."""
    return bool((world.signed_distance(_between(points)) >= radius).all())


def _between(points: Array) -> Array:
    """Return closely spaced points (m, 2) on straight lines through points (n, 2), including these."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    counts = np.maximum(1, np.ceil(lengths / _STEP)).astype(int)
    parts = [
        one + np.linspace(0.0, 1.0, count, endpoint=False)[:, None] * (other - one)
        for one, other, count in zip(points[:-1], points[1:], counts, strict=True)
    ]
    return np.concatenate((*parts, points[-1:]))
