"""Drives a short, slow, bounded pattern, and notes when it commanded what.

The pattern turns by 0.8 rad to both sides, drives 0.16 m ahead and back, and at the end lets commands stop coming
during a turn on the spot. It needs a metre of free space, or wheels in the air. `LidarRobot` stops it before
obstacles and on unusable scans, and sends the last zero.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from rclpy.executors import Executor

from ctrl_rl_bringup.preflight.finding import Limits
from ctrl_rl_core import LIDAR_PARAMETERS, LidarRobot, Parameter, RobotNode, VelocityError

SPEED, TURN_RATE = 0.08, 0.5
"""Speed [m/s] and turn rate [rad/s] of the pattern."""
REST_S = 1.2
"""Time between two moves [s]: the robot comes to a stand, and its lidar sees a few whole turns."""
_PERIOD_S = 0.05
_LOOK_S = 3.0
"""Time that the mover waits for its first scan and odometry [s]."""


@dataclass(frozen=True)
class Phase:
    """A part of the pattern with one command.

    Attributes:
        name: Name of the phase, as it is told while it runs.
        v: Commanded speed [m/s], positive ahead.
        omega: Commanded turn rate [rad/s], positive to the left.
        seconds: Duration of the phase [s].
        silent: Whether no command is sent at all.
    """

    name: str
    v: float
    omega: float
    seconds: float
    silent: bool = False


_REST = Phase("rest", 0.0, 0.0, REST_S)
PATTERN = (
    _REST,
    Phase("turn left", 0.0, TURN_RATE, 1.6),
    _REST,
    Phase("turn right", 0.0, -TURN_RATE, 1.6),
    _REST,
    Phase("ahead", SPEED, 0.0, 2.0),
    _REST,
    Phase("back", -SPEED, 0.0, 2.0),
    _REST,
    Phase("turn left again", 0.0, TURN_RATE, 0.8),
    Phase("no commands", 0.0, 0.0, 1.5, silent=True),
    _REST,
)


@dataclass(frozen=True)
class Part:
    """A phase as it was driven.

    Attributes:
        phase: Phase of the pattern that was driven.
        begin: Steady time at which it began [s].
        end: Steady time at which it ended [s].
        stopped: Reason why less was sent than the phase wants; empty where all was.
    """

    phase: Phase
    begin: float
    end: float
    stopped: str = ""


class Mover(RobotNode):
    """Sends the pattern's commands; its parameters are those of every node that drives by lidar."""

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *LIDAR_PARAMETERS,
        Parameter("scan_timeout", 1.0, "Age of scan or odometry that stops the robot [s].", 0.05, 10.0),
    )

    robot: LidarRobot

    def __init__(self) -> None:
        super().__init__("preflight_mover")
        self.robot = LidarRobot(self)
        self.robot.set_limits((-SPEED, -TURN_RATE), (SPEED, TURN_RATE))

    def send(self, phase: Phase) -> str:
        """Send a phase's command and return why less of it was sent; empty where all was."""
        command = np.array((phase.v, phase.omega))
        try:
            sent = self.robot.drive(command)
        except VelocityError as error:
            self.robot.halt(str(error))
            return str(error)
        return "" if np.array_equal(sent, command) else self.robot.problem


def mover_parameters(in_the_air: bool, unstamped: bool, limits: Limits) -> Iterator[str]:
    """Yield the parameters of a mover as `name:=value`; in the air no scan can say what is in the way."""
    yield f"enable_stamped_cmd_vel:={str(not unstamped).lower()}"
    yield f"lidar_x:={float(limits.lidar_x)}"
    yield f"lidar_yaw:={float(limits.lidar_yaw)}"
    yield f"scan_timeout:={min(max(2.0 * limits.largest_gap, 0.05), 10.0)}"
    if in_the_air:
        yield from ("robot_radius:=0.0", "min_echo_share:=0.0", "largest_gap:=6.3", "frozen_scans:=0")


def run_pattern(mover: Mover, executor: Executor, progress: Callable[[str], None]) -> list[Part]:
    """Drive the pattern and return its parts; whatever interrupts it, the last command is zero."""
    parts: list[Part] = []
    begin = time.monotonic()
    while mover.robot.input_fault() and time.monotonic() < begin + _LOOK_S:
        executor.spin_once(timeout_sec=_PERIOD_S)
    try:
        for phase in PATTERN:
            progress(phase.name)
            parts.append(_run(mover, executor, phase))
            if parts[-1].stopped:
                break
    finally:
        mover.stop()
    return parts


def _run(mover: Mover, executor: Executor, phase: Phase) -> Part:
    begin = now = time.monotonic()
    stopped = ""
    while now < begin + phase.seconds:
        if not phase.silent:
            stopped = stopped or mover.send(phase)
        following = now + _PERIOD_S
        while (now := time.monotonic()) < following:
            executor.spin_once(timeout_sec=following - now)
    return Part(phase, begin, now, stopped)
