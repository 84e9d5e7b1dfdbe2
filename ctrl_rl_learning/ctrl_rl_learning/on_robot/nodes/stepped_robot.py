"""A simulated robot whose time stands still while nobody drives: the bridge is stepped, the filter answers."""

from __future__ import annotations

import time

import numpy as np
from ctrl_rl_core.ros import seconds
from std_srvs.srv import SetBool

from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.on_robot.nodes.ros_robot import Ros, RosRobot, Starts
from ctrl_rl_msgs.srv import StepWorld

SLICE_S = 0.1
"""Simulated time between two answers of the safety filter [s]; its control_period must be a little longer."""
_REPEAT_S = 0.01
_ENOUGH_S = 0.5
"""Wall time after which an answer to the command before will do: the new one then counts a slice later [s]."""
_ROUNDING_S = 1e-4


class SteppedRobot(RosRobot):
    """A robot of a paused bridge.

    Each slice of time ends when scan and odometry of its end are here, and when the filter has answered the command
    that was sent then. How fast the computer is does not matter.
    """

    def __init__(self, ros: Ros, starts: Starts, simulator: str = "sim_bridge") -> None:
        """Take hold of the simulator's time."""
        super().__init__(ros, starts)
        self._time = 0.0
        self._step = ros.node.create_client(StepWorld, f"{simulator}/step")
        self._pause = ros.node.create_client(SetBool, f"{simulator}/pause")
        ros.call(self._pause, SetBool.Request(data=True))

    def now(self) -> float:
        """Return the time of the simulator after the last slice [s]."""
        return self._time

    def stamp_now(self) -> float:
        """Return the same time: that of the simulator."""
        return self._time

    def release(self) -> None:
        """Let the simulator's time run again."""
        self._ros.call(self._pause, SetBool.Request(data=False))

    def advance(self, until: float) -> None:
        """Step the simulator to a time [s]; at least one slice where it is not known yet."""
        while True:
            self._slice(SLICE_S if until <= self._time else min(SLICE_S, until - self._time))
            if self._time >= until - _ROUNDING_S:
                return

    def _pass_time(self) -> None:
        """Step the simulator: time that stands brings no fresh inputs.

        They are too old where one came before the clock's first word, or where this process was held up for seconds.
        """
        self._slice(SLICE_S)

    def _slice(self, duration: float) -> None:
        response = self._ros.call(self._step, StepWorld.Request(duration=duration))
        if not response.success:
            raise LearningError(f"the simulator cannot be stepped: {response.message}")
        self._time = seconds(response.stamp)
        node, wanted = self._ros.node, self._time - _ROUNDING_S
        oldest = self._time - 0.5 * SLICE_S
        self._ros.until(
            lambda: min(node.stamp, node.odometry_stamp) > oldest,
            f"a stepped simulator must send scan and odometry every {SLICE_S:g} s: none",
        )
        begun = sent = time.monotonic()
        node.send()
        while not self._answered(wanted, any_command=time.monotonic() - begun > _ENOUGH_S):
            self._ros.spin(_REPEAT_S)
            now = time.monotonic()
            if now - begun > self._ros.patience:
                raise LearningError("the safety filter is silent: nothing is driven without it")
            if now - sent > _REPEAT_S:  # the filter's clock may have been behind when the command came
                sent = now
                node.send()

    def _answered(self, time_: float, any_command: bool) -> bool:
        """Return whether the filter has answered the command that holds, or any, at a time [s]."""
        status, command = self._ros.node.status_of_filter, self._ros.node.held
        if status is None or seconds(status.header.stamp) < time_:
            return False
        if any_command or status.mode == status.WAITING:
            return True
        return bool(np.abs(command - (status.raw_speed, status.raw_turn_rate)).max() < 1e-9)
