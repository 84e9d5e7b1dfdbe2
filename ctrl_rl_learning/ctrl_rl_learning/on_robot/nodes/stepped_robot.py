"""A simulated robot that pauses while nothing drives: this code steps the bridge and waits for the safety filter."""

from __future__ import annotations

import time

import numpy as np
from ctrl_rl_core.ros import seconds
from std_srvs.srv import SetBool

from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.on_robot.nodes.ros_robot import Ros, RosRobot, Starts
from ctrl_rl_msgs.srv import StepWorld

SLICE_S = 0.1
"""Simulated time between two outputs of the safety filter [s]; the filter's control_period must be a little longer."""
_REPEAT_S = 0.01
_ENOUGH_S = 0.5
"""Wall time after which an answer to the previous command is accepted [s]; the new command then acts a slice later."""
_ROUNDING_S = 1e-4


class SteppedRobot(RosRobot):
    """Robot of a paused simulator bridge.

    A time slice ends once its last scan and odometry have arrived and the filter has answered the command sent at that
    time. Results therefore do not depend on the speed of the computer.
    """

    def __init__(self, ros: Ros, starts: Starts, simulator: str = "sim_bridge") -> None:
        """Pause the simulator and take over its clock."""
        super().__init__(ros, starts)
        self._time = 0.0
        self._step = ros.node.create_client(StepWorld, f"{simulator}/step")
        self._pause = ros.node.create_client(SetBool, f"{simulator}/pause")
        ros.call(self._pause, SetBool.Request(data=True))

    def now(self) -> float:
        """Return the simulator time after the last slice [s]."""
        return self._time

    def stamp_now(self) -> float:
        """Return the simulator time, which is also used for stamps [s]."""
        return self._time

    def release(self) -> None:
        """Let the simulator run freely again."""
        self._ros.call(self._pause, SetBool.Request(data=False))

    def advance(self, until: float) -> None:
        """Step the simulator to a time [s], or by at least one slice if the simulator time is still unknown."""
        while True:
            self._slice(SLICE_S if until <= self._time else min(SLICE_S, until - self._time))
            if self._time >= until - _ROUNDING_S:
                return

    def _pass_time(self) -> None:
        """Step the simulator, because a paused simulator sends no fresh inputs.

        Inputs are too old if one arrived before the first clock message or if this process stalled for seconds.
        """
        self._slice(SLICE_S)

    def _slice(self, duration: float) -> None:
        response = self._ros.call(self._step, StepWorld.Request(duration=duration))
        if not response.success:
            raise LearningError(f"the simulator did not step: {response.message}")
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
                raise LearningError("the safety filter is silent: the robot does not drive without it")
            if now - sent > _REPEAT_S:  # the filter's clock may have lagged when the command arrived
                sent = now
                node.send()

    def _answered(self, time_: float, any_command: bool) -> bool:
        """Return whether the filter has answered the current command, or any command, by a time [s]."""
        status, command = self._ros.node.status_of_filter, self._ros.node.held
        if status is None or seconds(status.header.stamp) < time_:
            return False
        if any_command or status.mode == status.WAITING:
            return True
        return bool(np.abs(command - (status.raw_speed, status.raw_turn_rate)).max() < 1e-9)
