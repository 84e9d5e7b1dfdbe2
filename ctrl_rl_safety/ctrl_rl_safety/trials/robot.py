"""A simulated robot whose base carries out commands as a `RobotModel` does, with or without the filter before it.

The model of the base and that of the filter may differ: this is how a trial drives with less braking than the filter
assumes.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from ctrl_rl_core.sensing.scan import view_scan
from numpy.typing import NDArray

from ctrl_rl_core import Outcome
from ctrl_rl_safety.filter.map_walls import MapWalls
from ctrl_rl_safety.filter.safety_filter import SafetyFilter
from ctrl_rl_safety.filter.verdict import Mode, Reading
from ctrl_rl_safety.models.motion import STANDS, motion_of, next_speeds
from ctrl_rl_safety.models.robot_model import RobotModel
from sim_bridge import SimulatedWorld

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


class _OwnWheels:
    """Hands commands on: the wheels of the engine move as their motors do."""

    def __init__(self) -> None:
        self._command = (0.0, 0.0)

    def send(self, time: float, command: Array) -> None:  # noqa: ARG002 - see Base
        """Take a command (2,)."""
        self._command = float(command[0]), float(command[1])

    def advance(self, time: float) -> tuple[float, float]:  # noqa: ARG002 - see Base
        """Return the last command [m/s, rad/s]."""
        return self._command


class TrialRobot:
    """The robot of a world, driven by raw commands.

    Attributes:
        world: World that it drives in.
        ticks: Number of commands so far.
        changed: Number of them that the filter changed.
        distance: Way driven [m].
    """

    def __init__(
        self,
        world: SimulatedWorld,
        base: RobotModel | None,
        safety: SafetyFilter | None,
        with_set: bool = True,
        tick: float = TICK,
        walls: MapWalls | None = None,
    ) -> None:
        """Take the robot of a world that was just reset.

        Args:
            world: World with one robot on wheels, whose `motor_lag` is `MOTOR_LAG` where the base has constants.
            base: Constants by which its base moves; None for the motors and the delay of the world.
            safety: Filter before the base; None for none.
            with_set: Whether the recoverable set is solved at each scan; the filter has its fixed escapes otherwise.
            tick: Time between two answers of the filter [s].
            walls: Map that the filter has, on which the robot knows its place; None for none.
        """
        self.world, self._safety, self._with_set, self._walls = world, safety, with_set, walls
        rate = world.options.rate
        self._base = _OwnWheels() if base is None else Base(base, 1.0 / rate)
        self._tick, self._steps = tick, max(1, round(tick * rate))
        self._turn = max(1, round(rate / world.lidar.spec.rate))
        robot = world.task.robot.robot
        assert robot is not None, "a robot on wheels"
        self._forward = robot.lidar.x
        self.ticks = self.changed = 0
        self.distance = 0.0
        self._stood_at: Array = world.pose()[:2]
        self._speed = 0.0
        self._touched: bool | None = None

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return self.world.episode().outcome is not Outcome.RUNNING

    @property
    def avoidable(self) -> bool:
        """Whether it ended by a contact that the robot could have avoided.

        A contact is avoidable unless a mover ran into a robot that stood, or overran the place where it stood last:
        a robot that then flees in vain would have been met there too.
        """
        return self._touched is True

    @property
    def run_into(self) -> bool:
        """Whether it ended by a contact that the robot could not avoid."""
        return self._touched is False

    def drive(self, raw: Array, seconds: float) -> Array:
        """Hold a raw command (2,) for a time, or until the episode ends.

        Args:
            raw: Speed [m/s] and turn rate [rad/s].
            seconds: Time, a whole number of ticks [s].

        Returns:
            The mean of the commands that were sent (2,).
        """
        sent = []
        for _ in range(max(1, round(seconds / self._tick))):
            command = raw
            if self._safety is not None:
                command, mode = self._answer(self._safety, raw)
                self.changed += mode is not Mode.PASSED
            self.ticks += 1
            sent.append(command)
            self._base.send(self.world.elapsed, command)
            self._advance()
            if self.over:
                break
        mean: Array = np.mean(sent, axis=0)
        return mean

    def _answer(self, safety: SafetyFilter, raw: Array) -> tuple[Array, Mode]:
        world, now = self.world, self.world.elapsed
        odometry = world.odometry()
        if world.steps % self._turn < self._steps:  # the first tick after the lidar's turn is complete
            scan = world.laser_scan()
            points = view_scan(scan.ranges, scan.geometry, safety.reach, self._forward).points
            fixed = None if self._walls is None else self._walls.fixed(world.pose(), odometry.pose)
            safety.see(now, odometry.pose, points, fixed=fixed)
            if self._with_set:
                safety.use(safety.solve())
        forward, _, turn = odometry.velocity.tolist()
        verdict = safety.decide(now, Reading(odometry.pose, forward, turn), raw)
        safety.sent(now, verdict.command)
        return verdict.command, verdict.mode

    def _advance(self) -> None:
        world = self.world
        for _ in range(self._steps):
            before = float(world.velocity()[0])
            if abs(before) < STANDS:
                self._stood_at = world.pose()[:2]
            world.command(0, self._base.advance(world.elapsed))
            world.step()
            self.distance += abs(before) / world.options.rate
            contact = world.episode().contact
            if contact is not None and self._touched is None:
                moved = max(abs(before), abs(float(world.velocity()[0]))) >= _STOOD
                self._touched = contact.mover is None or (moved and not self._overrun(contact.mover))
                return

    def _overrun(self, mover: int) -> bool:
        states = self.world.movers()
        gap = math.dist(states.positions[mover].tolist(), self._stood_at.tolist())
        return gap <= states.radii[mover] + self.world.task.robot.radius
