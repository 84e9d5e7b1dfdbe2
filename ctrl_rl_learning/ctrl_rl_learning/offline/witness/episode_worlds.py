"""The walls of each recorded episode, where a task draws them anew: width and doorways of a corridor, by the scans."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.tasks import wrap
from numpy.typing import NDArray
from scipy.optimize import minimize
from sim_bridge.engines import shape_row
from sim_bridge.fleet import scans

from ctrl_rl_core import Box, Interval, NavigationTask, World
from ctrl_rl_learning.offline.data.motion import displaced
from ctrl_rl_learning.offline.witness.beams import Beams, FileWalls, compare
from ctrl_rl_learning.offline.witness.record import Sightings, lidar_place

Array = NDArray[np.float64]
_SCANS, _BEAMS = 12, 180
"""Most scans of an episode, and beams of a scan, that one wall is fitted to."""
_FEWEST_ENDS = 10
"""Beams that must end at a partition to know its doorway."""
_CAP = 0.15
"""Error of a range beyond which a beam says no more [m]: it met something else."""
_RIM, _BESIDE = 0.1, 0.05
"""Room around the places that a partition may take, and distance that tells it from the corridor's walls [m]."""
_EXPLAINED, _FEW = 0.5, 0.01
"""Share of the differing beams that walls of the episodes' own may leave, and share of all that is not worth a fit."""
_GRID = 9
"""Number of values of a parameter that a fit begins with."""


@dataclass(frozen=True)
class EpisodeWalls:
    """Walls of an episode, and how far its wheels rolled.

    Attributes:
        width: Free width of the corridor [m].
        shares: Of each doorway place along the path, offset and width as shares of their ranges (n, 3).
        seen: Whether scans show each doorway (n,); others are drawn by the task.
        scale: Ratio of the true to the recorded ways, where a task draws the radius of the wheels; else 1.
    """

    width: float
    shares: Array
    seen: NDArray[np.bool_]
    scale: float = 1.0

    def world(self, task: NavigationTask) -> World:
        """Return walls and obstacles of a task in this episode."""
        world = task.build_world(self.width)
        if task.doorways is None or task.corridor is None:
            return world
        shapes = tuple(obstacle.shape for obstacle in task.obstacles)
        for number, shares in enumerate(self.shares):
            shapes += task.doorways.partition(task.corridor, self.width, number, shares)
        return replace(world, obstacles=shapes)


class BesideOwnWalls(NamedTuple):
    """Beams beside the walls of their episodes.

    Attributes:
        beams: The beams with their votes.
        walls: Walls of each episode by its number; empty where the file's explain the beams.
        seen: Scans at the poses by the true radius of the wheels.
    """

    beams: Beams
    walls: dict[int, EpisodeWalls]
    seen: Sequence[Sightings]

    def worlds(self, task: NavigationTask) -> dict[int, World]:
        """Return the worlds of episodes that have their own."""
        return {number: walls.world(task) for number, walls in self.walls.items()}


def draws_walls(task: NavigationTask) -> bool:
    """Return whether a task's walls may be others in each episode."""
    return task.corridor is not None and (task.doorways is not None or task.corridor.width_range.length > 0.0)


def beside_own_walls(seen: Sequence[Sightings], task: NavigationTask, random: np.random.Generator) -> BesideOwnWalls:
    """Return beams beside a file's walls, or beside each episode's own where a task draws them and these are others.

    Args:
        seen: Scans with their poses.
        task: Task that was driven.
        random: Draws doorways that no scan shows.
    """
    usual = BesideOwnWalls(compare(seen, FileWalls(task)), {}, seen)
    if not draws_walls(task) or usual.beams.differing <= _FEW:
        return usual
    drawn = walls_of_episodes(seen, task, random)
    poses = [replace(each, poses=at_true_scale(each.poses, each.episodes, drawn)) for each in seen]
    own = compare(poses, FileWalls(task, {number: walls.world(task) for number, walls in drawn.items()}))
    return BesideOwnWalls(own, drawn, poses) if own.differing < _EXPLAINED * usual.beams.differing else usual


def at_true_scale(poses: Array, episodes: NDArray[np.integer], walls: Mapping[int, EpisodeWalls]) -> Array:
    """Return poses (N, 3) of episodes (N,) with the ways that their wheels truly rolled."""
    out = poses.copy()
    for number, each in walls.items():
        rows = episodes == number
        if each.scale != 1.0 and rows.any():
            out[rows] = scaled(poses[rows], each.scale)
    return out


def scaled(poses: Array, scale: float) -> Array:
    """Return poses (N, 3) x, y, theta that begin at the first one and go `scale` times as far, and turn so."""
    turned = wrap(np.diff(poses[:, 2]))
    middles = poses[:-1, 2] + 0.5 * turned
    cos, sin = np.cos(middles), np.sin(middles)
    dx, dy = np.diff(poses[:, :2], axis=0).T
    ahead, left = scale * (cos * dx + sin * dy), scale * (cos * dy - sin * dx)
    headings = poses[0, 2] + np.append(0.0, np.cumsum(scale * turned))
    middles = headings[:-1] + 0.5 * scale * turned
    cos, sin = np.cos(middles), np.sin(middles)
    steps = np.stack((cos * ahead - sin * left, sin * ahead + cos * left), axis=1)
    places = poses[0, :2] + np.vstack((np.zeros(2), np.cumsum(steps, axis=0)))
    return np.column_stack((places, wrap(headings)))


def walls_of_episodes(
    seen: Sequence[Sightings], task: NavigationTask, random: np.random.Generator
) -> dict[int, EpisodeWalls]:
    """Return the walls of each recorded episode by its number; none where a task's are always the same.

    Args:
        seen: Scans with their poses.
        task: Task that was driven.
        random: Draws doorways that no scan shows.
    """
    if not draws_walls(task):
        return {}
    found: dict[int, EpisodeWalls] = {}
    for each in seen:
        beams = max(1, len(each.bearings) // _BEAMS)
        few = replace(each, bearings=each.bearings[::beams], ranges=each.ranges[:, ::beams])
        for number in np.unique(few.episodes).tolist():
            found[number] = _fit(few.rows(few.episodes == number), task, random)
    return found


def _fit(seen: Sightings, task: NavigationTask, random: np.random.Generator) -> EpisodeWalls:
    assert task.corridor is not None
    # Where nothing was met, a beam passed all that is in reach; what was not measured says nothing.
    ranges = np.where(np.isposinf(seen.ranges), seen.reach, seen.ranges).astype(np.float64)
    width, scale = _fit_walls(ranges, seen, task)
    if task.doorways is None:
        return EpisodeWalls(width, np.empty((0, 3)), np.empty(0, np.bool_), scale)
    lidars = _lidars(seen, task, scale)
    count = task.doorways.count(task.corridor)
    shares, known = random.uniform(size=(count, 3)), np.zeros(count, np.bool_)
    for number in range(count):
        found = _fit_doorway(lidars, ranges, seen, task, width, number)
        if found is not None:
            shares[number], known[number] = found, True
    return EpisodeWalls(width, shares, known, scale)


def _lidars(seen: Sightings, task: NavigationTask, scale: float) -> Array:
    return displaced(scaled(seen.poses, scale), np.array([(*lidar_place(task), 0.0)]))


def _fit_walls(ranges: Array, seen: Sightings, task: NavigationTask) -> tuple[float, float]:
    """Return width of the corridor and scale of the ways by which most beams end at walls; some meet other things."""
    corridor = task.corridor
    assert corridor is not None
    few = np.unique(np.linspace(0, len(ranges) - 1, _SCANS).astype(int))
    wheels = task.randomisation.get("wheel_radius", Interval(1.0, 1.0))
    bounds = ((corridor.width_range.low, corridor.width_range.high), (wheels.low, wheels.high))

    def error(given: Array) -> float:
        width, scale = given.tolist()
        expected = _cast(corridor.walls(width), _lidars(seen, task, scale)[few], seen)
        return float(np.nanmean(np.minimum(np.abs(ranges[few] - np.minimum(expected, seen.reach)), _CAP)))

    width, scale = _least(error, _grid(bounds), bounds).tolist()
    return width, scale


def _fit_doorway(
    lidars: Array, ranges: Array, seen: Sightings, task: NavigationTask, width: float, number: int
) -> Array | None:
    """Return the shares (3,) of a doorway at whose sides beams end, and pass through none; None where few are there."""
    corridor, doorways = task.corridor, task.doorways
    assert corridor is not None
    assert doorways is not None
    headings = wrap(lidars[:, 2:] + seen.bearings)
    ends = lidars[:, None, :2] + ranges[..., None] * np.stack((np.cos(headings), np.sin(headings)), axis=-1)
    x, y, heading = corridor.path.pose((number + 1) * doorways.spacing).tolist()
    across = (ends - (x, y)) @ np.array(((np.cos(heading), -np.sin(heading)), (np.sin(heading), np.cos(heading))))
    near = np.abs(across[..., 0]) < doorways.shift + 0.5 * doorways.thickness + _RIM
    here = near & (np.abs(across[..., 1]) < 0.5 * width - _BESIDE) & (ranges < seen.reach)
    if here.sum() < _FEWEST_ENDS:
        return None
    few = np.argsort(here.sum(axis=1))[::-1][:_SCANS]
    places, measured, ended = lidars[few], ranges[few], here[few]

    def error(shares: Array) -> float:
        boxes = doorways.partition(corridor, width, number, shares)
        expected = _cast(boxes, places, seen)
        passed = np.clip(measured - expected, 0.0, _CAP)
        missed = np.where(ended, np.clip(expected - measured, 0.0, _CAP), 0.0)
        return float(np.nanmean(passed + missed))

    varies = (doorways.shift > 0.0, doorways.offset.length > 0.0, doorways.width.length > 0.0)
    bounds = tuple((0.0, 1.0) if each else (0.5, 0.5) for each in varies)
    return _least(error, _grid(bounds), bounds)


def _grid(bounds: Sequence[tuple[float, float]]) -> Array:
    """Return points (m, n) of a grid within bounds."""
    sides = [np.linspace(low, high, _GRID) if high > low else np.array((low,)) for low, high in bounds]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, len(sides))


def _least(error: Callable[[Array], float], grid: Array, bounds: Sequence[tuple[float, float]]) -> Array:
    """Return where an error is least (n,): around the best point of a grid (m, n), within bounds."""
    best = grid[int(np.argmin([error(point) for point in grid]))].copy()
    low, high = np.array(bounds).T
    free, size = high > low, (high - low) / (_GRID - 1)

    def of_free(given: Array) -> float:
        whole = best.copy()
        whole[free] = given
        return error(whole)

    if free.any():
        step = 0.25 * size[free]  # a corner at a bound would be reflected onto itself
        begin: Array = np.clip(best[free], low[free] + step, high[free] - step)
        simplex = begin + np.vstack((np.zeros(len(step)), np.diag(step)))
        options: Any = {"initial_simplex": simplex, "xatol": 0.02 * float(step.max()), "fatol": 1e-5, "maxfev": 80}
        inner = [pair for pair, varies in zip(bounds, free, strict=True) if varies]
        best[free] = minimize(of_free, begin, method="Nelder-Mead", bounds=inner, options=options).x
    return best


def _cast(boxes: Sequence[Box], lidars: Array, seen: Sightings) -> Array:
    """Return the ranges (N, B) [m] to boxes, +inf where a beam meets none."""
    out = np.empty((len(lidars), len(seen.bearings)))
    scans(np.array([shape_row(box) for box in boxes]), lidars, seen.bearings, seen.reach, out)
    return out
