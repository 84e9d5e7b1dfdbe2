"""What an environment asks of a robot, real or simulated."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Outcome, Sensors

Array = NDArray[np.float64]


class StepEnd(NamedTuple):
    """The robot at the end of a step.

    Attributes:
        sensors: Last scan, odometry, pose and goal.
        outcome: Outcome of the episode by the simulator or the operator; None where nobody says, and the pose decides.
        late_scans: Number of scans of the step that were too old on arrival, or out of order.
    """

    sensors: Sensors
    outcome: Outcome | None
    late_scans: int


class Driven(NamedTuple):
    """The commands of a step.

    Attributes:
        command: Mean of the commands that were sent to the filter, by time (2,).
        operator: Part of the time in which the operator drove.
        changed: Part of the filter's answers that were not the raw command.
    """

    command: Array
    operator: float
    changed: float


class Robot(Protocol):
    """A robot behind its safety filter."""

    def now(self) -> float:
        """Return the time on the robot's clock [s]."""

    def begin(self, seed: int) -> StepEnd:
        """Bring the robot to a start and return its reading; a simulator draws the start from the seed.

        Raises:
            LearningError: The robot, its simulator or its safety filter does not answer.
        """

    def drive(self, command: Array, until: float) -> Driven:
        """Send a command (2,) until a time on the robot's clock [s]; an operator's commands go before it.

        Raises:
            LearningError: The robot, its simulator or its safety filter does not answer.
        """

    def read(self) -> StepEnd:
        """Return what the robot senses.

        Raises:
            LearningError: A part of it is missing.
        """

    def stand(self) -> None:
        """Let the robot stand."""
