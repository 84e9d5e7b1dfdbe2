"""Node that records drives for learning: a model-free driver that stays between the walls and adds noise.

EDMD needs data with excited controls and lateral offsets; the driver is not meant as a baseline for the learnt
policies.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from ctrl_rl_core.ros import robot_parameter

from ctrl_rl_core import DRIVER_PARAMETERS, DriverNode, NodeDriver, Parameter, Sensors, run_node
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.sensing.observables import CorridorObservables

_SIDE_GAIN = 1.8
_AHEAD_GAIN = 0.6
_MEMORY = 0.8


class ScriptedDriver(NodeDriver):
    """Steers towards the side with more room, at a varying speed, with coloured noise on both commands."""

    def __init__(self, node: DriverNode) -> None:
        """Create the driver of a node."""
        value = node.settings
        self.sectors = CorridorObservables().sectors
        self._random = np.random.default_rng(value["seed"])
        self._speed = float(value["speed"])
        self._deviation = np.array([value["speed_noise"], value["turn_noise"]])
        most = np.array([value["largest_speed"], value["largest_turn_rate"]])
        self.limits = -most, most
        self._noise = np.zeros(2)
        left = np.rad2deg(self.sectors.bearings[len(self.sectors.bearings) // 2 :])
        self._beside, self._ahead = (left >= 60) & (left <= 120), (left >= 20) & (left <= 60)

    def command(self, sensors: Sensors) -> Array:
        """Return speed [m/s] and turn rate [rad/s] (2,).

        Raises:
            ScanError: The scan has no measurement.
        """
        distances = self.sectors.distances(sensors.ranges, sensors.scan)
        half = len(distances) // 2
        left, right = distances[half:], distances[half - 1 :: -1]
        off_middle = np.mean(right[self._beside] - left[self._beside])
        bend = np.mean(np.log(right[self._ahead] / left[self._ahead]))
        step = np.sqrt(1.0 - _MEMORY**2) * self._deviation * self._random.standard_normal(2)
        self._noise = _MEMORY * self._noise + step
        return np.array([self._speed, -_SIDE_GAIN * off_middle - _AHEAD_GAIN * bend]) + self._noise


class ScriptedDriverNode(DriverNode):
    """Drives a robot between walls with noisy commands, to record drives from which a model can be learnt.

    Subscribes to scan and odom, publishes cmd_vel.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *DRIVER_PARAMETERS,
        Parameter("seed", 0, "Seed of the noise on the commands.", 0, 2**31 - 1),
        Parameter("speed", 0.15, "Mean speed [m/s].", 0.0, 2.0),
        Parameter("turn_noise", 0.3, "Standard deviation of the noise on the turn rate [rad/s].", 0.0, 2.0),
        Parameter("speed_noise", 0.04, "Standard deviation of the noise on the speed [m/s].", 0.0, 0.1),
        robot_parameter("largest_speed", "speed", "Limit of the commanded speed [m/s].", 0.01, 20.0),
        robot_parameter("largest_turn_rate", "turn_rate", "Limit of the commanded turn rate [rad/s].", 0.01, 50.0),
    )

    def __init__(self) -> None:
        super().__init__("scripted_driver", ScriptedDriver)


def main() -> int:
    """Run the node."""
    return run_node(ScriptedDriverNode)
