"""A simulated robot whose base carries out commands as a `RobotModel` does, with or without a filter before it.

The model of the base and that of the filter may differ: this is how a trial drives with less braking than the filter
assumes.
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
"""Time between two answers of the filter [s]."""
MOTOR_LAG = 1e-3
"""Lag of the simulated wheels [s]: the base's own model has the lag."""
_STOOD = 2.0 * STANDS
"""Speed below which a robot that is touched counts as standing [m/s]: the model's 0.01 m/s, and as much for the time
between two looks."""


class Base:
    """Delays commands, and ramps the speeds that the wheels are told."""

    def __init__(self, model: RobotModel, step: float) -> None:
        self._motion, self._delay = motion_of(model, step), model.delay
        self._waiting: deque[tuple[float, float, float]] = deque()
        self._wanted, self._speeds = (0.0, 0.0), (0.0, 0.0)

    def send(self, time: float, command: Array) -> None:
        """Take a command (2,) at a time [s]."""
        self._waiting.append((time + self._delay, float(command[0]), float(command[1])))

    def advance(self, time: float) -> tuple[float, float]:
        """Return the speeds to tell the wheels for the step that begins at a time [m/s, rad/s]."""
        while self._waiting and self._waiting[0][0] <= time + 1e-9:
            self._wanted = self._waiting.popleft()[1:]
        self._speeds = next_speeds(*self._speeds, *self._wanted, self._motion)
        return self._speeds


class RobotFilter(Filter[Sensors], Protocol):
    """A filter at the robot, which answers at each tick.

    Attributes:
        looks: Whether it wants each turn of the lidar.
        changed: Whether its last answer was another command.
    """

    looks: bool
    changed: bool


class TrialRobot:
    """The robot of a world behind its filter, in Gymnasium's form: one step holds a raw command for a whole period.

    Attributes:
        world: World that it drives in.
        ticks: Number of commands so far.
        changed: Number of them that the filter changed.
        distance: Way driven [m].
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
        """Take the robot of a world.

        Args:
            world: World with one robot, whose `motor_lag` is `MOTOR_LAG` where the base has constants.
            base: Constants by which its base moves; None for the motors and the delay of the world.
            make_filter: Makes the filter of an episode; None for no filter.
            period: Time for which a step holds its command, a whole number of ticks [s]; one tick unless given.
            tick: Time between two answers of the filter [s].
            goal: Goal x, y, theta of its driver (3,); None for none.
            blind: Whether its driver looks at no scan, so that none is taken for it.
        """
        self.world, self._model, self._make_filter = world, base, make_filter
        self._tick, self._period, self._goal, self._looks = tick, tick if period is None else period, goal, not blind
        rate = world.options.rate
        self._steps, self._turn = max(1, round(tick * rate)), max(1, round(rate / world.lidar.spec.rate))
        self._flies, self._last = world.plane == "xz", world.rest
        self.ticks, self.changed, self.distance = 0, 0, 0.0
        self._begin()

    def reset(self, *, seed: int) -> tuple[Sensors, dict[str, Any]]:
        """Begin the episode of a seed, unless the world stands at its start."""
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
            seconds: Time, a whole number of ticks [s].

        Returns:
            The mean of the commands that were sent (2,).
        """
        sent = []
        for _ in range(max(1, round(seconds / self._tick))):
            command = raw
            if self._filter is not None:
                turned = self.world.steps % self._turn < self._steps  # the first tick after a turn is complete
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
        """Whether it ended by a contact that the robot could have avoided; a quadrotor avoids each, and a tilt.

        A contact is avoidable unless a mover ran into a robot that stood, or overran the place where it stood last:
        a robot that then flees in vain would have been met there too.
        """
        return self._touched is True or (self._flies and self.world.episode().outcome is Outcome.COLLISION)

    @property
    def run_into(self) -> bool:
        """Whether it ended by a contact that the robot could not avoid."""
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
        """Let a tick pass, or less where the robot touches something."""
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
