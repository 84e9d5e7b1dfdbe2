"""What the bags themselves show of walls and movers, as the models of roll-outs need it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from ctrl_rl_core.policies import ScanPart
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Outcome, World
from ctrl_rl_learning.offline.data.motion import displaced, displacements
from ctrl_rl_learning.offline.data.transitions import Transitions, sensed_interface
from ctrl_rl_learning.offline.evaluation.surroundings import Surroundings
from ctrl_rl_learning.offline.witness.beams import LONGER, SHORTER, Beams, dropout_of
from ctrl_rl_learning.offline.witness.episode_worlds import EpisodeWalls, beside_own_walls, scaled
from ctrl_rl_learning.offline.witness.limits import inner_radius
from ctrl_rl_learning.offline.witness.movers import MoverReach, draw_plans
from ctrl_rl_learning.offline.witness.record import Sightings, lidar_place

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_COMPARED, _FEWEST_BEAMS = 500_000, 90
"""Most ranges that are compared with the walls, about, and beams of a scan that are kept before scans are left out."""
_OFF = 0.05
"""Distance from the file's walls that contradicts them, beside three tenths of the robot's radius [m]."""
_MORE, _ERRORS = 1.5, 2.0
"""Factor, and standard errors beside it, by which the bags may show more of the movers than the task's law."""


@dataclass(frozen=True)
class Recorded:
    """Bags beside the walls and the movers of their task.

    Attributes:
        task: Task that was driven.
        transitions: The bags.
        worlds: Walls of each episode in order, or one world for all.
        beams: Recorded ranges with their votes on those walls.
        reach: Places where the task's movers may be.
    """

    task: NavigationTask
    transitions: Transitions
    worlds: tuple[World, ...]
    beams: Beams
    reach: MoverReach

    @property
    def episodes(self) -> NDArray[np.intp]:
        """Number of the episode of each transition (N,), from 0."""
        return np.cumsum(self.transitions.first) - 1

    def walls(self) -> Surroundings:
        """Return the walls alone, by episode."""
        return Surroundings(self.task, self.worlds)

    @property
    def shown_by_movers(self) -> Mask:
        """Which of the beams end at something that moves (M,)."""
        return (self.beams.votes == SHORTER) & self.reach.holds(self.beams.ends)

    @property
    def scans_off(self) -> float:
        """Share of the recorded ranges that neither walls nor movers explain."""
        off = (self.beams.votes == SHORTER) & ~self.shown_by_movers | (self.beams.votes == LONGER)
        if dropout_of(self.task) > 0.0:
            off &= self.beams.echoes
        return float(off.mean()) if len(off) else 0.0

    @property
    def hits_of_movers(self) -> Mask:
        """Which transitions ended where there is no wall, but may be a mover (N,)."""
        room = _room(self.task) + 0.5 * np.abs(displacements(self.transitions)[:, 0])
        ends = self.transitions.next_states
        open_air = self.walls().clearance(self.episodes, ends) > room
        hit = (self.transitions.outcomes == Outcome.COLLISION) & open_air
        return np.asarray(hit & self.reach.holds(ends[:, :2], self.task.robot.radius))

    @property
    def contradicted(self) -> float:
        """Share of the episodes that pass through the file's obstacles, or collide where nothing is by it."""
        given, room = self.transitions, _room(self.task)
        free, way = self.walls().clearance(self.episodes, given.next_states), np.abs(displacements(given)[:, 0])
        depth = self.task.robot.radius - inner_radius(self.task) + room  # a long body passes by its narrow side
        inside = (given.outcomes == Outcome.RUNNING) & (free < -depth)
        nothing_there = (given.outcomes == Outcome.COLLISION) & (free > room + 0.5 * way) & ~self.hits_of_movers
        starts = np.flatnonzero(given.first)
        return float((np.add.reduceat((inside | nothing_there).astype(np.int64), starts) > 0).mean())

    def movers(self, random: np.random.Generator) -> tuple[float, float]:
        """Return the share of the ranges that end at movers, and the largest that the task's law explains."""
        if not self.task.movers:
            return 0.0, 0.0
        count = self.transitions.episode_count
        shown, episodes = self.shown_by_movers, self.beams.episodes
        seen = np.bincount(episodes, shown, count) / np.maximum(np.bincount(episodes, minlength=count), 1)
        lawful = self._by_law(random)
        error = np.sqrt((seen.var() + lawful.var()) / count)
        return float(seen.mean()), float(_MORE * lawful.mean() + _ERRORS * error)

    def _by_law(self, random: np.random.Generator) -> Array:
        """Return the share of the ranges (episodes,) that movers of the task's law cut off along the recorded ways."""
        given, period = self.transitions, self.task.episode.time_step
        starts = np.append(np.flatnonzero(given.first), len(given))
        lengths, numbers = np.diff(starts), np.arange(given.episode_count)
        plans = draw_plans(self.task, self.worlds, given.states[given.first], random)
        around = Surroundings(self.task, self.worlds, plans=plans)
        part = next(each for each in sensed_interface(self.task).observation if isinstance(each, ScanPart))
        mount = np.array([(*lidar_place(self.task), 0.0)])
        walls, cut, count = self.walls(), np.zeros(len(numbers)), np.zeros(len(numbers))
        for step in range(int(lengths.max())):
            which = numbers[step < lengths]
            states = given.states[starts[which] + step]
            lidars = displaced(states, mount)
            nearer = around.mover_ranges(which, lidars, part) < walls.ranges(which, lidars, part) - _OFF
            cut[which] += nearer.mean(axis=1)
            count[which] += 1.0
            for _ in range(around.mover_steps):
                around.advance(which, states)
                around.tick(period / around.mover_steps)
        return cut / np.maximum(count, 1.0)


def look_at(transitions: Transitions, task: NavigationTask, seed: int) -> Recorded:
    """Return bags beside the walls and movers of their task; doorways and widths are those of each episode's scans.

    Raises:
        TaskError: No path of a mover is clear of walls and obstacles.
    """
    random = np.random.default_rng(seed)
    own = beside_own_walls([sightings_of(transitions, task)], task, random)
    worlds: tuple[World, ...] = (task.build_world(),)
    if own.walls:
        usual, drawn = worlds[0], own.worlds(task)
        worlds = tuple(drawn.get(number, usual) for number in range(transitions.episode_count))
        transitions = _at_true_scale(transitions, own.walls)
    return Recorded(task, transitions, worlds, own.beams, MoverReach(task, worlds, random))


def _at_true_scale(transitions: Transitions, walls: Mapping[int, EpisodeWalls]) -> Transitions:
    """Return transitions with the states by the true radius of the wheels."""
    states, after = transitions.states.copy(), transitions.next_states.copy()
    starts = np.append(np.flatnonzero(transitions.first), len(transitions))
    for number, each in walls.items():
        rows = slice(starts[number], starts[number + 1])
        way = scaled(np.vstack((states[rows], after[rows][-1:])), each.scale)
        states[rows], after[rows] = way[:-1], way[1:]
    return replace(transitions, states=states, next_states=after)


def sightings_of(transitions: Transitions, task: NavigationTask) -> Sightings:
    """Return the scans in a task's observations: at poses that follow closely, and with fewer beams in long drives."""
    before = 0
    for part in sensed_interface(task).observation:
        if isinstance(part, ScanPart):
            break
        before += part.size
    else:
        none = np.zeros(0, dtype=np.intp)
        return Sightings(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 0), np.float32), 1.0, none.astype(np.int64))
    stride = max(1, min(part.count // _FEWEST_BEAMS, math.ceil(len(transitions) * part.count / _COMPARED)))
    every = math.ceil(len(transitions) * part.count / stride / _COMPARED)
    ranges = transitions.observations[::every, before : before + part.count : stride]
    ranges = np.where(ranges >= part.high, np.float32(np.inf), ranges)
    episodes = (np.cumsum(transitions.first) - 1)[::every].astype(np.int64)
    return Sightings(transitions.states[::every], part.bearings[::stride], ranges, part.high, episodes)


def _room(task: NavigationTask) -> float:
    return max(_OFF, 0.3 * task.robot.radius)
