"""The interface of a robot, real or simulated, as the environment uses it."""

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
        outcome: Outcome that the simulator or the operator reported; None if neither did, and the pose decides.
        late_scans: Number of scans in the step that were too old on arrival or out of order.
    """

    sensors: Sensors
    outcome: Outcome | None
    late_scans: int


class Driven(NamedTuple):
    """The commands of a step.

    Attributes:
        command: Time-weighted mean of the commands sent to the filter (2,).
        operator: Fraction of the time in which the operator drove.
        changed: Fraction of the filter's outputs that differed from the raw command.
    """

    command: Array
    operator: float
    changed: float


class Robot(Protocol):
    """A robot behind its safety filter."""

    def now(self) -> float:
        """Return the time on the robot's clock [s]."""

    def begin(self, seed: int) -> StepEnd:
        """Reset the robot to a start and return its reading; a simulator draws the start from the seed.

        Raises:
            LearningError: The robot, its simulator or its safety filter does not answer.
        """

    def drive(self, command: Array, until: float) -> Driven:
        """Send a command (2,) until a time on the robot's clock [s]; an operator's commands take precedence.

        Raises:
            LearningError: The robot, its simulator or its safety filter does not answer.
        """

    def read(self) -> StepEnd:
        """Return the sensor readings.

        Raises:
            LearningError: A reading is missing.
        """

    def stand(self) -> None:
        """Stop the robot."""
