"""Settings of a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ctrl_rl_core import Interval, NavigationTask
from sim_bridge.errors import SimulationError


@dataclass(frozen=True)
class SimulationOptions:
    """Settings of a simulation.

    Attributes:
        engine: Physics engine: "pybullet", "mujoco", "planar" (no contact forces, several times faster), or "auto" for
            PyBullet if installed, else MuJoCo.
        rate: Physics steps per second [Hz].
        gui: Whether PyBullet's window is shown.
        scan_noise: Standard deviation of a range [m]; None for the task's.
        scan_dropout: Probability that a beam is lost; None for the task's.
        scan_rate: Scans per second [Hz]; None for the task's.
        lost_beam: Value of a lost beam of the task's lidar: "nan", "inf" or "zero".
        lidar: Name of a lidar in `sim_bridge.LIDARS`.
        odom_drift: Standard deviation of odometry's relative errors.
        command_truncation: Whether to truncate a drive's commands to hundredths, as the TurtleBot3 firmware does.
        command_delay: Time from the arrival of a command to its effect [s].
        command_timeout: Age of a command after which the robot goes idle [s]; 0 for never.
        friction: Friction coefficient between wheels and floor; the planar engine's wheels never slip.
        wheel_radius: Ratio of the true wheel radius to the one assumed by robot and odometry.
        motor_lag: Time constant of the wheels' speed [s]; None for the robot's own.
        randomise: Whether each episode draws settings from the task's ranges (`randomisation` in its file) instead of
            using these.
        randomise_width: Whether resets without a width draw the corridor's width from the task's range.
    """

    engine: str = "auto"
    rate: int = 240
    gui: bool = False
    scan_noise: float | None = None
    scan_dropout: float | None = None
    scan_rate: float | None = None
    lost_beam: str = "nan"
    lidar: str = "task"
    odom_drift: float = 0.0
    command_truncation: bool = False
    command_delay: float = 0.0
    command_timeout: float = 0.0
    friction: float = 1.0
    wheel_radius: float = 1.0
    motor_lag: float | None = None
    randomise: bool = True
    randomise_width: bool = False

    def drawn(self, ranges: Mapping[str, Interval], random: np.random.Generator) -> SimulationOptions:
        """Return the settings of one episode; if randomised, drawn from ranges by name."""
        if not ranges or not self.randomise:
            return self
        numbers: dict[str, Any] = {name: random.uniform(low, high) for name, (low, high) in sorted(ranges.items())}
        return replace(self, **numbers)


def whole_steps(task: NavigationTask, rate: int) -> int:
    """Return the number of physics steps in the task's time step.

    Raises:
        SimulationError: The number is not an integer at this rate [Hz].
    """
    steps = task.episode.time_step * rate
    if not _whole(steps):
        raise SimulationError(
            f"task '{task.name}': its time_step of {task.episode.time_step:g} s is {steps:g} physics steps "
            f"at {rate} Hz: give it {_nearest(steps, rate)} s, or choose another rate"
        )
    return round(steps)


def _whole(steps: float) -> bool:
    return abs(steps - round(steps)) <= 1e-6 and steps >= 0.5


def _nearest(steps: float, rate: int) -> float:
    """Return the time step [s], written to a microsecond, that is whole at a rate [Hz] and nearest to some steps."""
    counts = sorted(range(1, round(steps) + rate + 1), key=lambda count: abs(count - steps))
    return next(time for time in (round(count / rate, 6) for count in counts) if _whole(time * rate))
