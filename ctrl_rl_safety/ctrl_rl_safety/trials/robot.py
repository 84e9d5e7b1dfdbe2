"""A simulated robot whose base follows a `RobotModel`, with or without a filter.

The models of base and filter may differ, e.g. to give the base less braking than the filter assumes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from sim_bridge.simulation import begin_episode

from ctrl_rl_core import Filter, Outcome, Sensors
from ctrl_rl_safety.models.motion import STANDS, motion_of, next_speeds
from ctrl_rl_safety.models.robot_model import RobotModel
from sim_bridge import RobotSenses, SimulatedWorld

Array = NDArray[np.float64]

TICK = 0.05
"""Period of the filter [s]."""
MOTOR_LAG = 1e-3
"""Lag of the simulated wheels [s], small because the model of the base already has a lag."""
_STOOD = 2.0 * STANDS
"""Speed below which a touched robot counts as stationary [m/s]: the model's 0.01 m/s, plus the same for the time
between two checks."""


class Base:
    """Delays commands, and ramps the speeds sent to the wheels."""

    def __init__(self, model: RobotModel, step: float) -> None:
        self._motion, self._delay = motion_of(model, step), model.delay
        self._waiting: deque[tuple[float, float, float]] = deque()
        self._wanted, self._speeds = (0.0, 0.0), (0.0, 0.0)

    def send(self, time: float, command: Array) -> None:
        """Accept a command (2,) at a time [s]."""
        self._waiting.append((time + self._delay, float(command[0]), float(command[1])))

    def advance(self, time: float) -> tuple[float, float]:
        """Return the wheel speeds for the step that starts at a time [m/s, rad/s]."""
        while self._waiting and self._waiting[0][0] <= time + 1e-9:
            self._wanted = self._waiting.popleft()[1:]
        self._speeds = next_speeds(*self._speeds, *self._wanted, self._motion)
        return self._speeds


class RobotFilter(Filter[Sensors], Protocol):
    """A filter at the robot, called in each tick.

    Attributes:
        looks: Whether the filter needs every scan of the lidar.
        changed: Whether the last answer differed from the raw command.
    """

    looks: bool
    changed: bool


class TrialRobot:
    """The robot of a world behind its filter, with Gymnasium's interface; a step holds a raw command for a period.

    Attributes:
        world: World of the robot.
        ticks: Number of commands so far.
        changed: Number of commands changed by the filter.
        distance: Distance driven [m].
    """

    def __init__(
        self,
        world: SimulatedWorld,
        base: RobotModel | None = None,
        make_filter: Callable[[], RobotFilter] | None = None,
        *,
        period: float | None = None,
        tick: float = TICK,
        goal: Array | None = None,
        blind: bool = False,
    ) -> None:
        """Set up the robot of a world.

        Args:
            world: World with one robot; its `motor_lag` must be `MOTOR_LAG` if `base` is given.
            base: Constants of the base; None for the world's own motors and delay.
            make_filter: Creates the filter of an episode; None for no filter.
            period: Duration of a step, a whole number of ticks [s]; one tick by default.
            tick: Period of the filter [s].
            goal: Goal x, y, theta of the driver (3,), or None.
            blind: Whether the driver uses no scans, so that none are taken for it.
        """
        self.world, self._model, self._make_filter = world, base, make_filter
        self._tick, self._period, self._goal, self._looks = tick, tick if period is None else period, goal, not blind
        rate = world.options.rate
        self._steps, self._turn = max(1, round(tick * rate)), max(1, round(rate / world.lidar.spec.rate))
        self._flies, self._last = world.plane == "xz", world.rest
        self.ticks, self.changed, self.distance = 0, 0, 0.0
        self._begin()

    def reset(self, *, seed: int) -> tuple[Sensors, dict[str, Any]]:
        """Start the episode of a seed, unless the world is already at its start."""
        begin_episode(self.world, seed)
        self._begin()
        return self._shown(self.world.rest, self._looks), self._info()

    def step(self, command: Array) -> tuple[Sensors, float, bool, bool, dict[str, Any]]:
        """Hold a raw command (2,) for a period, or until the episode ends."""
        self.hold(command, self._period)
        outcome = self.world.episode().outcome
        cut = outcome is Outcome.TIMEOUT
        return self._shown(command, self._looks and not self.over), 0.0, self.over and not cut, cut, self._info()

    def hold(self, raw: Array, seconds: float) -> Array:
        """Hold a raw command (2,) for a time, or until the episode ends.

        Args:
            raw: Speed [m/s] and turn rate [rad/s], or thrusts [N].
            seconds: Duration, a whole number of ticks [s].

        Returns:
            The mean of the commands sent (2,).
        """
        sent = []
        for _ in range(max(1, round(seconds / self._tick))):
            command = raw
            if self._filter is not None:
                turned = self.world.steps % self._turn < self._steps  # the first tick after a complete scan
                command = self._filter(self._seen(self._last, self._filter.looks and turned, self.world.pose()), raw)
                self.changed += self._filter.changed
            self.ticks += 1
            sent.append(command)
            self._last = command
            if self._base is not None:
                self._base.send(self.world.elapsed, command)
            self._advance()
            if self.over:
                break
        mean: Array = np.mean(sent, axis=0)
        return mean

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return self.world.episode().outcome is not Outcome.RUNNING

    @property
    def avoidable(self) -> bool:
        """Whether the episode ended in an avoidable contact; for a quadrotor, every contact and tilt is avoidable.

        A contact is avoidable unless a mover ran into the stationary robot, or passed over the place where it last
        stood, where it would have been hit without fleeing as well.
        """
        return self._touched is True or (self._flies and self.world.episode().outcome is Outcome.COLLISION)

    @property
    def run_into(self) -> bool:
        """Whether the episode ended in a contact that the robot could not avoid."""
        return self._touched is False

    def _begin(self) -> None:
        world = self.world
        self._base = None if self._model is None else Base(self._model, 1.0 / world.options.rate)
        self._filter = None if self._make_filter is None else self._make_filter()
        self._shown, self._seen = RobotSenses(world, self._goal), RobotSenses(world)
        self._last, self.ticks, self.changed, self.distance = world.rest, 0, 0, 0.0
        self._stood_at: Array = world.pose()[:2]
        self._touched: bool | None = None

    def _info(self) -> dict[str, Any]:
        return {
            "outcome": self.world.episode().outcome.name,
            "seconds": self.world.elapsed,
            "distance": self.distance,
            "changed": self.changed / max(self.ticks, 1),
            "avoidable": self.avoidable,
            "run_into": self.run_into,
        }

    def _advance(self) -> None:
        """Advance by one tick, or less if the robot touches something."""
        world = self.world
        before = world.pose()[:2]
        for _ in range(self._steps):
            speed = float(world.velocity()[0])
            if abs(speed) < STANDS:
                self._stood_at = world.pose()[:2]
            world.command(0, self._last if self._base is None else self._base.advance(world.elapsed))
            world.step()
            if not self._flies:
                self.distance += abs(speed) / world.options.rate
            contact = world.episode().contact
            if contact is not None and self._touched is None and not self._flies:
                moved = max(abs(speed), abs(float(world.velocity()[0]))) >= _STOOD
                self._touched = contact.mover is None or (moved and not self._overrun(contact.mover))
                return
        if self._flies:
            self.distance += math.dist(before.tolist(), world.pose()[:2].tolist())

    def _overrun(self, mover: int) -> bool:
        states = self.world.movers()
        gap = math.dist(states.positions[mover].tolist(), self._stood_at.tolist())
        return gap <= states.radii[mover] + self.world.task.robot.radius
