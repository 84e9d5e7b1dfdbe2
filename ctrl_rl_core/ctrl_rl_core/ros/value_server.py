"""Base class of value-function nodes: a value per odometry message, grid, slice, queries and reload.

The time-to-reach node and the optimal-control node derive from `ValueServer` and read their own file types.
"""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
from nav_msgs.msg import OccupancyGrid, Odometry
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.processes.background import Job, start_job
from ctrl_rl_core.ros.node import LATCHED, RESULT, Status, SuiteNode, ok, warn
from ctrl_rl_core.ros.parameters import Parameter, ParameterError
from ctrl_rl_core.ros.stop_request import interruptible
from ctrl_rl_core.ros.value_messages import answer, grid_message, slice_message
from ctrl_rl_core.sensing.live_odometry import LiveOdometry
from ctrl_rl_core.sensing.odometry import OdometryError, OdometryReader
from ctrl_rl_core.values.value_function import ValueFunction
from ctrl_rl_core.values.value_grid import ValueGrid
from ctrl_rl_msgs.msg import StateValue
from ctrl_rl_msgs.msg import ValueGrid as ValueGridMsg
from ctrl_rl_msgs.srv import QueryValues

SERVER_PARAMETERS = (
    Parameter(
        "grid", "", "File of the value function (.safetensors); a change is loaded at once.", live=True, kind="path"
    ),
    Parameter("slice", [""], "NAME=VALUE: fixed components of ~/slice; 0 for the others.", live=True),
    Parameter("frame", "map", "Frame of the value function's positions; odometry is assumed to be in it."),
)
_EVERY_MESSAGE = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
"""QoS of odometry: best effort matches every publisher; the depth outlasts a burst."""
_STALE_S = 2.0
_LOOK_S = 0.05
"""Interval of the checks whether grid values are ready [s]."""
Valued = Callable[[Odometry, NDArray[np.float64], float], None]


class ValueServer(SuiteNode):
    """Publishes one StateValue per odometry message, and latched ~/grid and ~/slice; serves ~/query and ~/reload.

    Attributes:
        TOPIC: Topic of the StateValue.
        KIND: Kind of value function that the node serves.
    """

    TOPIC: ClassVar[str]
    KIND: ClassVar[str]
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = SERVER_PARAMETERS

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._counts = {"odometry": 0, "outside": 0, "unreachable": 0, "refused": 0}
        self._fault, self._odometry = "", LiveOdometry()
        self._outside, self._foreign, self._heard = False, False, 0.0
        self._grids: dict[str, Publisher] = {}
        self._sampling: Job[tuple[ValueGrid, ...]] = Job()
        self._look = self.create_timer(_LOOK_S, self._publish_sampled, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._slice = self.create_publisher(OccupancyGrid, "~/slice", LATCHED)
        self._load(self.settings["grid"])
        self.create_subscription(Odometry, "odom", self._on_odometry, _EVERY_MESSAGE)
        # Created last, so that this publisher signals that the function is loaded and odometry is subscribed.
        self._values = self.create_publisher(StateValue, self.TOPIC, RESULT)
        self.create_service(QueryValues, "~/query", self._on_query)
        self.create_service(Trigger, "~/reload", self._on_reload)

    @abstractmethod
    def read(self, path: Path) -> ValueFunction:
        """Read a file.

        Raises:
            CtrlRlError: The file is missing or invalid.
        """

    @abstractmethod
    def prepare(self, function: ValueFunction) -> Valued:
        """Return a function called with each odometry message, state (n,) and value before the StateValue is sent.

        Raises:
            CtrlRlError: The value function is rejected; the current one stays.
        """

    def status(self) -> Status:
        """Report the served function and the fraction of odometry outside its domain."""
        figures: dict[str, object] = {**self._counts, "file": self.settings["grid"], "digest": self._function.digest}
        if not self._counts["odometry"]:
            return warn("waiting for odometry", **figures)
        if time.monotonic() - self._heard > _STALE_S:
            return warn("no odometry any more", **figures)
        if self._fault:
            return warn(f"no value: {self._fault}", **figures)
        if self._outside:
            return warn("the robot is outside the grid", **figures)
        return ok("serving", **figures)

    def on_parameter_changed(self, name: str) -> None:
        """Load another file, or move the slice."""
        if name == "grid":
            self._load(self.settings["grid"])
        elif name == "slice":
            self._slice.publish(self._slice_of(self._function))

    def _load(self, file: str) -> None:
        if not file:
            meaning = next(each.description for each in self.PARAMETERS if each.name == "grid")
            raise ParameterError(f"parameter 'grid' is empty: {meaning}")
        with interruptible():
            prepared = self._prepared(file)
        self._serve(*prepared)
        self.get_logger().info(f"{Path(file).name} ({self._function.digest[:12]}): task '{self._function.task}'")

    def _prepared(self, file: str) -> tuple[ValueFunction, OdometryReader, Valued, OccupancyGrid]:
        """Prepare everything needed to serve a file."""
        function = self.read(Path(file))
        if function.kind != self.KIND:
            raise ParameterError(f"parameter 'grid': {file} holds '{function.kind}', not '{self.KIND}'")
        reader, slice_ = OdometryReader(function.state_names), self._slice_of(function)
        valued = self.prepare(function)
        function.value_and_gradient_at(np.zeros(len(function.state_names)))  # compile before timing matters
        return function, reader, valued, slice_

    def _serve(self, function: ValueFunction, reader: OdometryReader, valued: Valued, slice_: OccupancyGrid) -> None:
        """Replace the current function, after all checks have passed."""
        self._function, self._reader, self._valued = function, reader, valued
        self._slice.publish(slice_)
        # A network has no grid yet: computing millions of nodes takes half a minute, and must not delay odometry.
        self._sampling = start_job(lambda _: function.grids)
        self._look.reset()

    def _publish_sampled(self) -> None:
        """Publish the grids once their values are available."""
        if not self._sampling.finished.is_set():
            return
        self._look.cancel()
        if self._sampling.error is not None:
            raise self._sampling.error
        grids = self._sampling.result or ()
        self._publish_grids(grids)
        self.get_logger().info(f"~/grid: {' + '.join(str(grid.values.size) for grid in grids)} points")

    def _publish_grids(self, grids: tuple[ValueGrid, ...]) -> None:
        """Publish a single grid on ~/grid, or each of several on ~/grid_<its states>."""
        stamp = self.get_clock().now().to_msg()
        names = [
            "grid" if len(grids) == 1 else "_".join(("grid", *(axis.name for axis in grid.axes))) for grid in grids
        ]
        for gone in set(self._grids) - set(names):  # late joiners must not receive a grid that is no longer served
            self.destroy_publisher(self._grids.pop(gone))
        for name, grid in zip(names, grids, strict=True):
            if name not in self._grids:
                self._grids[name] = self.create_publisher(ValueGridMsg, f"~/{name}", LATCHED)
            self._grids[name].publish(grid_message(grid, stamp, self.settings["frame"]))

    def _slice_of(self, function: ValueFunction) -> OccupancyGrid:
        at = dict(map(partial(_named_value, "slice"), filter(None, self.settings["slice"])))
        return slice_message(function, at, self.get_clock().now().to_msg(), self.settings["frame"])

    def _on_odometry(self, message: Odometry) -> None:
        self._counts["odometry"] += 1
        self._heard = time.monotonic()
        try:
            odometry = self._odometry.read(message)
            if self._odometry.fault and self._reader.uses_twist:
                raise OdometryError(self._odometry.fault)
        except OdometryError as error:
            self._counts["refused"] += 1
            self._fault = str(error)
            self.get_logger().warning(f"no value: {error}", throttle_duration_sec=5.0)
            return
        self._fault, state = "", self._reader(odometry)
        value, gradient = self._function.value_and_gradient_at(state)
        outside = bool(np.isnan(value))
        if outside and not self._outside:
            self.get_logger().warning(f"outside the grid: {self._where(state)}", throttle_duration_sec=5.0)
        self._outside = outside
        self._counts["outside"] += outside
        self._counts["unreachable"] += bool(np.isposinf(value))
        frame = self.settings["frame"]
        if not self._foreign and message.header.frame_id not in ("", frame):
            self._foreign = True
            self.get_logger().warning(
                f"odometry is in frame {message.header.frame_id!r} and taken as given in '{frame}' (parameter 'frame')"
            )
        message.header.frame_id = frame
        self._valued(message, state, value)
        out = StateValue(header=message.header, value=value, in_domain=not outside)
        out.state, out.gradient = state.tolist(), gradient.tolist()
        self._values.publish(out)

    def _where(self, state: NDArray[np.float64]) -> str:
        return ", ".join(f"{name} = {x:.3g}" for name, x in zip(self._function.state_names, state, strict=True))

    def _on_query(self, request: QueryValues.Request, response: QueryValues.Response) -> QueryValues.Response:
        answer(self._function, request, response)
        return response

    def _on_reload(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self._load(self.settings["grid"])
        except CtrlRlError as error:
            response.success, response.message = False, str(error)
        else:
            response.success, response.message = True, f"loaded {self._function.digest[:12]}"
        return response


def _named_value(parameter: str, text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise ParameterError(f"parameter '{parameter}': '{text}' must be NAME=VALUE with a number") from None
