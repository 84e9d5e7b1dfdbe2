"""The scripted driver as a node: for recording drives to learn from."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from ctrl_rl_core.ros.node import run_node
from ctrl_rl_core.ros.parameters import Parameter

from koopman_lqr_controller.nodes.lidar_driver import DRIVER_PARAMETERS, LidarDriver, PendingDecision, SensorReading
from koopman_lqr_controller.nodes.scripted_driver import ScriptedDriver


class ScriptedDriverNode(LidarDriver[None]):
    """Drives a robot between walls with a shaking hand, to record drives that a model can be learned from.

    Subscribes to scan and odom, publishes cmd_vel.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *DRIVER_PARAMETERS,
        Parameter("seed", 0, "Seed of the noise on the commands.", 0, 2**31 - 1),
        Parameter("speed", 0.15, "Mean speed [m/s].", 0.0, 0.22),
        Parameter("turn_noise", 0.3, "Standard deviation of the noise on the turn rate [rad/s].", 0.0, 2.0),
        Parameter("speed_noise", 0.04, "Standard deviation of the noise on the speed [m/s].", 0.0, 0.1),
        Parameter("largest_speed", 0.22, "Limit of the commanded speed [m/s].", 0.01, 2.0),
        Parameter("largest_turn_rate", 2.84, "Limit of the commanded turn rate [rad/s].", 0.01, 10.0),
    )

    def __init__(self) -> None:
        super().__init__("scripted_driver")
        random = np.random.default_rng(self.settings["seed"])
        self._driver = ScriptedDriver(
            random, *(float(self.settings[name]) for name in ("speed", "turn_noise", "speed_noise"))
        )
        limits = np.array([self.settings["largest_speed"], self.settings["largest_turn_rate"]])
        self.set_limits(-limits, limits)

    def decide(self, reading: SensorReading) -> PendingDecision[None]:
        """Return the scripted command."""
        distances = self._driver.sectors.distances(reading.ranges, reading.scan)
        return PendingDecision(self._driver.command(distances), None)


def main() -> int:
    """Run the node."""
    return run_node(ScriptedDriverNode)
