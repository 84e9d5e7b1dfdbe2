"""Many robots of one task, each in its own world, with the equations of the planar engine.

    fleet = PlanarFleet(load_navigation_task("car_ttr"), size=8)
    for robot in range(8):
        fleet.begin(robot, seed=robot)
    outcomes = fleet.step(actions)                     # (8, 2) in [-1, 1]
    fleet.observations(), fleet.states(), fleet.rewards()

The caller starts a new episode for each robot whose outcome is not RUNNING.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ctrl_rl_core.values import cached_njit
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import NavigationTask, Outcome, System, draw_starts, terminal_reward
from sim_bridge.engines.engine import SEARCH_LIMIT, WALL_HEIGHT
from sim_bridge.engines.planar_engine import shape_row
from sim_bridge.engines.planar_geometry import (
    COLUMNS,
    COS,
    HALF_X,
    HALF_Y,
    RADIUS,
    SEEN,
    SIN,
    X,
    Y,
    cast,
    nearest,
    place,
)
from sim_bridge.errors import SimulationError
from sim_bridge.fleet.motion import make_motion
from sim_bridge.simulation.draws import Purpose, stream
from sim_bridge.simulation.observation_bounds import observation_bounds
from sim_bridge.simulation.options import whole_steps
from sim_bridge.simulation.world import TOUCH


@cached_njit
def clearances(shapes: Any, parts: Any, outer: int, places: Any, limit: float, out: Any) -> None:
    """Write the distance from each robot to the nearest shape [m], or the limit, into `out` (N,).

    Args:
        shapes: Static shapes (n, 8), followed by space for the robot's (m, 8).
        parts: Shapes of the robot (m, 7).
        outer: Number of the robot's outer shapes, listed first, which enclose all others.
        places: Positions and counter-clockwise angles of the robots (N, 3) [m, m, rad].
        limit: Distance to write if nothing is nearer [m].
        out: Signed distances (N,), written.
    """
    first, last = len(shapes) - len(parts), len(shapes)
    for i in range(len(places)):
        place(shapes, parts, first, last, places[i, 0], places[i, 1], places[i, 2])
        out[i] = nearest(shapes, first, last, outer, limit)


@cached_njit
def scans(standing: Any, origins: Any, bearings: Any, reach: float, out: Any) -> None:
    """Write the lidar ranges of each robot [m] into `out` (N, beams); infinite if a ray hits nothing.

    Args:
        standing: Static shapes (n, 8).
        origins: Positions and counter-clockwise angles of the lidars (N, 3) [m, m, rad].
        bearings: Bearings of the beams, counter-clockwise (beams,) [rad].
        reach: Length of a ray [m].
        out: Ranges, written; 0 for a lidar inside a shape.
    """
    rays = np.empty((len(bearings), 2))
    for i in range(len(origins)):
        x, y, angle = origins[i, 0], origins[i, 1], origins[i, 2]
        if _buried(standing, x, y):
            out[i] = 0.0
            continue
        for beam in range(len(bearings)):
            rays[beam, 0] = reach * math.cos(angle + bearings[beam])
            rays[beam, 1] = reach * math.sin(angle + bearings[beam])
        cast(standing, x, y, rays, out[i])
        for beam in range(len(bearings)):
            out[i, beam] = out[i, beam] * reach if out[i, beam] < 1.0 else np.inf


@cached_njit
def _buried(standing: Any, x: float, y: float) -> bool:
    """Return whether a point lies inside a shape that is visible to rays."""
    for index in range(len(standing)):
        shape = standing[index]
        dx, dy = x - shape[X], y - shape[Y]
        u = max(0.0, abs(shape[COS] * dx + shape[SIN] * dy) - shape[HALF_X])
        v = max(0.0, abs(shape[COS] * dy - shape[SIN] * dx) - shape[HALF_Y])
        if shape[SEEN] > 0.0 and (math.hypot(u, v) < shape[RADIUS] or (u == 0.0 and v == 0.0)):
            return True
    return False


Array = NDArray[np.float64]
Vector = NDArray[np.float32]

RATE = {"xy": 30, "xz": 60}
"""Physics steps per second [Hz], by plane; motion is exact between command changes."""


class PlanarFleet:
    """Robots of one task, invisible to each other.

    Motion, sensing and termination match `NavigationEnv` with `engine="planar"`; all lidar noise comes from one stream.

    Attributes:
        task: Task of the robots.
        system: Model of the task, which defines names and order of the states.
        outcomes: Outcome of each robot's episode, values of `Outcome` (N,).
        clearance: Distance from each robot to the nearest wall or obstacle [m] (N,), at most `SEARCH_LIMIT`.
    """

    def __init__(self, task: NavigationTask, size: int, rate: int | None = None, seed: int = 0) -> None:
        """Place the robots at the task's start.

        Args:
            task: Task in an arena or on a map.
            size: Number of robots.
            rate: Physics steps per second [Hz]; `RATE` by default.
            seed: Seed of the lidar noise; robot i starts an episode of seed i.

        Raises:
            SimulationError: The task is in a corridor, or its world changes between episodes.
        """
        for name, found in (
            ("corridor", task.corridor),
            ("movers", task.movers),
            ("randomisation", task.randomisation),
        ):
            if found:
                raise SimulationError(
                    f"task '{task.name}': a fleet does not support '{name}': simulate one robot at a time"
                )
        self.task, self._rate = task, RATE[task.plane] if rate is None else rate
        self.system: System = task.system.build()
        self._substeps = whole_steps(task, self._rate)
        self._world = task.build_world()
        self._motion = make_motion(task, self.system, size, self._rate)
        self._sense = 1.0 if task.plane == "xy" else -1.0  # psi is clockwise in the x-z plane
        self._parts, self._outer = self._motion.outline
        shapes = [shape_row(shape) for shape in (*self._world.walls, *self._world.obstacles)]
        self._shapes = np.concatenate((np.array(shapes).reshape(-1, COLUMNS), np.zeros((len(self._parts), COLUMNS))))
        self._shapes[len(shapes) :, 4:7] = self._parts[:, 2:5]
        seen = task.plane == "xz" or self._motion.lidar[2] <= WALL_HEIGHT
        self._seen = self._shapes[: len(shapes) if seen else 0].copy()
        _, self._low, self._high = observation_bounds(task)
        self._commands = np.array(list(task.robot.commands.values()))
        self._tilt = math.inf if task.robot.tilt_limit is None else task.robot.tilt_limit
        self._limit = task.episode.steps * self._substeps
        self._random = np.random.default_rng(seed)
        lidar = task.lidar
        self._bearings = lidar.angle_min + lidar.angle_increment * np.arange(lidar.beams)
        self.outcomes = np.zeros(size, dtype=np.intp)
        self.clearance = np.full(size, SEARCH_LIMIT)
        self._tilted, self._steps = np.zeros(size, dtype=bool), np.zeros(size, dtype=np.intp)
        for robot in range(size):
            self.begin(robot, robot)

    def __len__(self) -> int:
        """Return the number of robots."""
        return len(self.outcomes)

    def begin(self, robot: int, seed: int, start: ArrayLike | None = None) -> None:
        """Start an episode of one robot.

        Args:
            robot: Index of the robot.
            seed: Seed of its start, as in `NavigationEnv`.
            start: State (n,) to start in; drawn from the task's start set by default.
        """
        if start is None:
            random, radius = stream(seed, Purpose.START), self.task.robot.radius
            (state,) = draw_starts(self.task, self.system, self._world, 1, radius, random)
        else:
            state = np.array(start, dtype=float)
        self._motion.begin(robot, dict(zip(self.system.state_names, state.tolist(), strict=True)))
        self.outcomes[robot], self._tilted[robot], self._steps[robot] = Outcome.RUNNING, False, 0
        self._judge(np.arange(robot, robot + 1))

    def step(self, actions: ArrayLike) -> NDArray[np.intp]:
        """Hold actions (N, 2) in [-1, 1] for the task's time step, and return the outcomes (N,).

        Raises:
            SimulationError: The actions are not two finite numbers per robot.
        """
        given = np.asarray(actions, dtype=float)
        if given.shape != (len(self), 2) or not np.isfinite(given).all():
            raise SimulationError(f"actions are two finite numbers for each of {len(self)} robots")
        low, high = self._commands.T
        self._motion.command(low + 0.5 * (np.clip(given, -1.0, 1.0) + 1.0) * (high - low))
        for _ in range(self._substeps):
            self._motion.advance()
            self._steps += 1
            self._judge(np.arange(len(self)))
        return self.outcomes

    def states(self) -> Array:
        """Return the true states (N, n), angles in [-pi, pi)."""
        known = self._motion.states()
        if known is not None:
            return known
        names = self.system.state_names
        values = dict(zip(("x", self.task.plane[1], "angle"), self._motion.poses.T, strict=True))
        values["theta"] = values["psi"] = np.mod(values["angle"] + np.pi, 2.0 * np.pi) - np.pi
        if not values.keys() >= set(names):
            values |= dict(zip(("v_x", "v_z", "omega"), self._motion.velocities().T, strict=True))
            values["v"] = values["v_x"] * np.cos(values["angle"]) + values["v_z"] * np.sin(values["angle"])
        states = np.empty((len(self), len(names)))
        for index, name in enumerate(names):
            states[:, index] = values[name]
        return states

    def observations(self) -> Vector:
        """Return the observations in SI units (N, d), as in `NavigationEnv`."""
        ranges = np.empty((len(self), len(self._bearings)))
        origins = self._places()
        along, aside, _, yaw = self._motion.lidar
        c, s = np.cos(origins[:, 2]), np.sin(origins[:, 2])
        origins[:, 0] += c * along - s * aside
        origins[:, 1] += s * along + c * aside
        origins[:, 2] += yaw
        lidar = self.task.lidar
        scans(self._seen, origins, self._bearings, lidar.range.high, ranges)
        if lidar.noise > 0.0:
            ranges += lidar.noise * self._random.standard_normal(ranges.shape)
        ranges[ranges > lidar.range.high] = lidar.range.high
        if lidar.dropout > 0.0:
            ranges[self._random.random(ranges.shape) < lidar.dropout] = lidar.range.high
        observed = np.concatenate((self.states(), ranges), axis=1).astype(np.float32)
        return np.clip(observed, self._low, self._high)

    def rewards(self) -> Array:
        """Return the task's rewards for the current outcomes (N,) (thesis Eq. 3.9, 3.15, 3.17)."""
        rewards = self.task.rewards
        return terminal_reward(self.outcomes, rewards, self._tilted, running=rewards.intermediate)

    def _places(self) -> Array:
        """Return positions and counter-clockwise angles (N, 3) [m, m, rad]."""
        return self._motion.poses * (1.0, 1.0, self._sense)

    def _judge(self, robots: NDArray[np.intp]) -> None:
        """Update the outcomes; only the first event of an episode counts."""
        free = np.empty(len(robots))
        places = self._places()[robots]
        clearances(self._shapes, self._parts, self._outer, places, SEARCH_LIMIT, free)
        self.clearance[robots] = free
        names, states, task = self.system.state_names, self.states()[robots], self.task
        tilted = np.abs(places[:, 2]) > self._tilt
        touching = free <= TOUCH
        found = np.zeros(len(robots), dtype=np.intp)  # later lines take precedence
        found[self._steps[robots] >= self._limit] = Outcome.TIMEOUT
        if task.trap is not None:
            found[task.trap.region.contains(names, states)] = Outcome.TRAP
        found[task.goal.region.contains(names, states)] = Outcome.GOAL
        found[tilted | touching] = Outcome.COLLISION
        running = self.outcomes[robots] == Outcome.RUNNING
        self._tilted[robots] |= running & tilted & ~touching
        self.outcomes[robots] = np.where(running, found, self.outcomes[robots])
