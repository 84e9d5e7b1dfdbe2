"""Monitor of a robot's motion relative to its model and of its lidar's mounting angle."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_safety.models.robot_model import RobotModel
from ctrl_rl_safety.monitor.bounds import Bounds, differences
from ctrl_rl_safety.monitor.model_monitor import ModelMonitor
from ctrl_rl_safety.monitor.mounting import Mounting

Array = NDArray[np.float64]


class RobotMonitor:
    """Monitor of a robot's motion and of the mounting angle of its lidar.

    Args:
        stated: Model of the robot.
        forward: Position of the lidar ahead of the robot's centre [m].
        unproven_braking: Fraction of the stated braking to discount until the robot has demonstrated it.
        unproven_delay: Delay to add to the stated one until the robot has demonstrated a shorter one [s].
    """

    def __init__(
        self, stated: RobotModel, forward: float, unproven_braking: float = 0.2, unproven_delay: float = 0.15
    ) -> None:
        self.motion = ModelMonitor(stated, unproven_braking, unproven_delay)
        self.mounting = Mounting(forward)

    @property
    def model(self) -> RobotModel:
        """Model with the current bounds."""
        return self.motion.model

    @property
    def soonest(self) -> float:
        """Shortest delay that the robot may have [s]."""
        return min(self.motion.soonest, self.model.delay)

    @property
    def problem(self) -> str:
        """Reason why the robot must stop; empty if there is none."""
        return self.motion.problem or self.mounting.problem

    def forget(self) -> None:
        """Forget poses, because the odometry frame has jumped."""
        self.motion.forget()
        self.mounting.forget()

    def words(self) -> str:
        """Describe the bounds that have grown; empty if none has."""
        grown = differences(self.motion.grown.of(self.motion.stated), self.motion.stated)
        if not grown:
            return ""
        return "the robot is not as its model says: " + ", ".join(f"{name} {value}" for name, value in grown.items())

    def figures(self) -> dict[str, str]:
        """Return the bounds that have grown and the remaining margins, for diagnostics."""
        motion = self.motion
        out = differences(motion.grown.of(motion.stated), motion.stated)
        unproven = motion.unproven
        if unproven != Bounds():
            names = [
                name for name, value in (("delay", unproven.delay > 0.0), ("braking", unproven.braking < 1.0)) if value
            ]
            out["not shown yet"] = " and ".join(names)
        if self.mounting.yaw:
            out["lidar turned by [deg]"] = f"{math.degrees(self.mounting.yaw):.0f}"
        return out
