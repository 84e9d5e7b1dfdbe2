"""Base class of all nodes: quality of service, settings, diagnostics, start and shutdown.

A node of this suite is a class derived from `SuiteNode`, run by `run_node`:

    class Controller(SuiteNode):
        PARAMETERS = (Parameter("timeout", 0.5, "Age of a stale scan [s].", minimum=0.05, maximum=5.0),)

        def __init__(self) -> None:
            super().__init__("controller")
            self.create_timer(self.settings["timeout"], self.stop)


    def main() -> int:
        return run_node(Controller)
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from builtin_interfaces.msg import Time as TimeMsg
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from numpy.typing import NDArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ctrl_rl_core.errors import CtrlRlError, one_line
from ctrl_rl_core.ros.callback_faults import Faults
from ctrl_rl_core.ros.parameter_service import CheckedParameterService
from ctrl_rl_core.ros.parameters import Parameter, ParameterError, check_all, declare

if TYPE_CHECKING:
    from ctrl_rl_core.ros.goal_server import GoalServer

SENSOR = qos_profile_sensor_data
"""QoS of subscriptions to scan and odom: best effort matches every publisher, including real robots."""
SCAN_PUBLISHER = QoSProfile(depth=5)
ODOM_PUBLISHER = QoSProfile(depth=10)
COMMAND = QoSProfile(depth=1)
RESULT = QoSProfile(depth=100)
"""QoS of rewards, values, latents and episode states: every message counts, bursts are buffered."""
DIAGNOSTICS = "/diagnostics"
"""Topic for the robots of all namespaces, as ROS's aggregator expects; a status carries the node's full name."""
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)

Status = tuple[bytes, str, Mapping[str, object]]
"""Level (a DiagnosticStatus constant), one line of text, key figures."""


class SuiteNode(Node):
    """A node with checked settings, diagnostics at 1 Hz of wall time, and a clean shutdown.

    Callback errors do not end the node: they are counted, shown in the log and in diagnostics, and passed to
    `on_callback_error`. Log level debug shows the traceback.

    Attributes:
        PARAMETERS: Table of the node's parameters.
        FATAL: Callback errors that end the node, because it cannot continue its work.
        faults: Failures of its callbacks.
        executor_name: Kind of executor that runs the node.
        goal_servers: Action servers, which end with the node.
        QUICK: Whether to use the events executor: half the latency and CPU of the default one, whose cost grows with
            every timer and service; it supports neither raw subscriptions nor guard conditions.
        SHARED_MEMORY: Whether Fast DDS may use shared memory. Disable it in a node that drives a robot: a process
            killed while it holds a shared-memory lock freezes the others. A user's own choice of transports takes
            precedence, and with ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST rmw_fastrtps always uses shared memory.
        settings: Parameter values by name, updated by `ros2 param set`.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = ()
    FATAL: ClassVar[tuple[type[Exception], ...]] = ()
    QUICK: ClassVar[bool] = True
    SHARED_MEMORY: ClassVar[bool] = True

    def __init__(self, name: str, **kwargs: Any) -> None:
        self.faults = Faults(self.on_callback_error, self.get_logger, self.FATAL)  # needed before the first callback
        self._refused_requests = 0
        self.executor_name = ""
        self.goal_servers: list[GoalServer] = []
        super().__init__(name, start_parameter_services=False, **kwargs)
        for service in self.services:  # created by rclpy itself
            service.callback = self.faults.guard_service(service.callback, service.srv_name)
        self._checked_parameters = CheckedParameterService(self, self._refuse)
        self.settings = declare(self, self.PARAMETERS)
        for given in self._parameter_overrides:
            if not self.has_parameter(given):
                self.get_logger().warning(
                    f"parameter '{given}' is unknown to this node and has no effect: --help lists the parameters"
                )
        self.add_on_set_parameters_callback(self._set_parameters)
        self._diagnostics = self.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        self.create_timer(1.0, self._publish_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def is_active(self) -> bool:
        """Whether the node may act: always, unless a lifecycle manager holds it."""
        return True

    def status(self) -> Status:
        """Return the status for `diagnostics`; override it."""
        return ok("running")

    def diagnostics_stamp(self) -> TimeMsg:
        """Return the current ROS time (wall or simulated); override it in the node that publishes /clock."""
        return self.get_clock().now().to_msg()

    def on_parameter_changed(self, name: str) -> None:
        """React to a changed live parameter; override it if needed.

        Raises:
            CtrlRlError: The value is invalid; the parameter keeps its old value.
        """

    def stop(self) -> None:
        """Finish the work (send zero velocity, close a file) while publishers still work; called once. Override it."""

    def on_suspend(self) -> None:
        """Bring the robot to a safe state before Ctrl-Z suspends the process; override it in nodes that drive."""

    def on_callback_error(self, error: Exception) -> None:
        """React to a callback error, already counted and logged; override it in nodes that drive.

        Such a node stops the robot, and keeps it stopped while `faults.failing` names an input.
        """

    def create_timer(self, timer_period_sec: float, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Create a timer with a callback that cannot end the node."""
        return super().create_timer(timer_period_sec, self.faults.guard(callback, "timer"), *args, **kwargs)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., Any], *args: Any, **kwargs: Any
    ) -> Any:
        """Create a subscription with a callback that cannot end the node."""
        return super().create_subscription(msg_type, topic, self.faults.guard(callback, topic), *args, **kwargs)

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[..., Any], *args: Any, **kwargs: Any
    ) -> Any:
        """Create a service with a callback that cannot end the node; on failure, the client gets an empty response."""
        callback = self.faults.guard_service(callback, srv_name)
        return super().create_service(srv_type, srv_name, callback, *args, **kwargs)

    def other_publishers(self, topic: str) -> tuple[str, ...]:
        """Return the full names of all other nodes that publish on `topic` (a resolved name), sorted.

        A second node with the same name counts too: starting a controller twice is the most likely mistake.
        """
        names = sorted(_name_of(info) for info in self.get_publishers_info_by_topic(topic))
        own = self.get_fully_qualified_name()
        if own in names:
            names.remove(own)
        return tuple(names)

    def publishers_of_other_types(self, topic: str, kind: str) -> tuple[str, ...]:
        """Return "/name (pkg/msg/Type)" for each publisher on `topic` of a type other than `kind`, never received."""
        infos = self.get_publishers_info_by_topic(topic)
        return tuple(sorted(f"{_name_of(info)} ({info.topic_type})" for info in infos if info.topic_type != kind))

    def call_soon(self, callback: Callable[[], Any]) -> None:
        """Call `callback` after the messages received so far (events executor), or at once (other executors)."""
        executor = self.executor
        if executor is None:
            callback()
        else:
            executor.create_task(self.faults.guard(callback, "task"))

    def _refuse(self, reason: str) -> None:
        self._refused_requests += 1
        self.get_logger().warning(f"parameter request refused: {reason}", throttle_duration_sec=5.0)

    def _status(self) -> Status:
        """Return the node's status, including callback failures."""
        try:
            level, message, values = self.status()
        except Exception as error:  # a failing status is reported as a status
            self.faults.note("status", error)
            level, message, values = DiagnosticStatus.ERROR, "no status", {}
        values = {**values, "executor": self.executor_name}
        if self._refused_requests:
            values["refused parameter requests"] = self._refused_requests
        if self.faults.count:
            values |= {"failed callbacks": self.faults.count, "last failure": self.faults.last}
        if self.faults.recent:
            return DiagnosticStatus.ERROR, f"callback failed: {self.faults.last}", values
        return level, message, values

    def _publish_diagnostics(self) -> None:
        level, message, values = self._status()
        status = DiagnosticStatus(
            level=level,
            name=self.get_fully_qualified_name(),
            message=message,
            hardware_id=self.get_namespace(),
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        out = DiagnosticArray(status=[status])
        out.header.stamp = self.diagnostics_stamp()
        self._diagnostics.publish(out)

    def _set_parameters(self, changes: list[Any]) -> SetParametersResult:
        try:
            values = check_all(self.PARAMETERS, {change.name: change.value for change in changes})
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        before, taken = dict(self.settings), list[str]()
        for name, value in values.items():
            self.settings[name] = value
            try:
                self.on_parameter_changed(name)
            except Exception as error:
                if not isinstance(error, CtrlRlError):
                    self.faults.note(f"on_parameter_changed ({name})", error)
                self.settings |= before
                for other in taken:  # all or nothing: on failure ROS keeps all old values
                    self.on_parameter_changed(other)
                return SetParametersResult(successful=False, reason=one_line(error))
            taken.append(name)
        return SetParametersResult(successful=True)


def _name_of(info: TopicEndpointInfo) -> str:
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def ok(message: str, **values: object) -> Status:
    """Return a healthy status."""
    return DiagnosticStatus.OK, message, values


def warn(message: str, **values: object) -> Status:
    """Return a warning status."""
    return DiagnosticStatus.WARN, message, values


def seconds(stamp: TimeMsg) -> float:
    """Convert a time stamp to seconds."""
    return stamp.sec + 1e-9 * stamp.nanosec


def nanoseconds(stamp: TimeMsg) -> int:
    """Convert a time stamp to whole nanoseconds."""
    return int(stamp.sec * 10**9 + stamp.nanosec)


def to_stamp(nanoseconds: int) -> TimeMsg:
    """Convert whole nanoseconds to a time stamp."""
    return TimeMsg(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def float32_array(values: NDArray[np.floating]) -> array[float]:
    """Convert `values` to the array type that a float32[] field takes directly; an ndarray is copied by element."""
    out = array("f")
    out.frombytes(np.ascontiguousarray(values, dtype=np.float32).tobytes())
    return out
