"""The base of drivers whose drive has an end: the episode's in a simulator, or a distance."""

from __future__ import annotations

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from numpy.typing import NDArray

from ctrl_rl_core.driving.arrival import ENDED, Arrival
from ctrl_rl_core.driving.lidar_driver import LidarDriver
from ctrl_rl_core.driving.velocity_node import VelocityError
from ctrl_rl_core.ros.node import RESULT, Status
from ctrl_rl_core.ros.parameters import Parameter
from ctrl_rl_msgs.msg import EpisodeStatus

MAX_DISTANCE = Parameter(
    "max_distance",
    0.0,
    "Distance by odometry after which the robot stands until this parameter is set again [m]; 0.0 for none.",
    0.0,
    1e6,
    live=True,
)


class EpisodeDriver(LidarDriver):
    """Stands once the episode has an outcome, or after the distance that the parameter `max_distance` allows."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._arrival = Arrival(self.settings["max_distance"])
        self.create_subscription(EpisodeStatus, "episode", self._on_episode, RESULT)

    def on_odometry(self, message: Odometry, odometry: NDArray[np.float64]) -> None:
        """Count the way by the pose; call it from an override."""
        super().on_odometry(message, odometry)
        self._arrival.went(float(odometry[0]), float(odometry[1]))

    def check_drive(self, now: float, speed: float) -> None:
        """Note the speed [m/s] by odometry at the time of a scan [s].

        Raises:
            VelocityError: The drive is over.
        """
        self._arrival.moved(now, speed)
        over = self._arrival.reason()
        if over:
            raise VelocityError(over)

    def on_episode(self, message: EpisodeStatus) -> None:
        """Act on the state of the simulator's episode; override it where it matters."""

    def on_parameter_changed(self, name: str) -> None:
        """Begin a drive anew when its distance is set."""
        if name == "max_distance":
            self._arrival.max_distance = self.settings["max_distance"]
            self._arrival.begin()
        else:
            super().on_parameter_changed(name)

    def status(self) -> Status:
        """Return whether commands flow; a robot that stands because all is done is well."""
        level, message, figures = super().status()
        if self.problem.startswith(ENDED) and not figures["other publishers"]:
            level = DiagnosticStatus.OK
        return level, message, {**figures, "driven [m]": f"{self._arrival.travelled:.2f}"}

    def _on_episode(self, message: EpisodeStatus) -> None:
        """Stand at once where a simulator says that the episode is over: the next scan may be a while away."""
        self._arrival.episode(message.episode, message.outcome.value)
        over = self._arrival.reason()
        if over and self.moving:
            self.halt(over)
        self.on_episode(message)
