"""The node that shows a live robot, and passes on what visitors with the token ask for."""

from __future__ import annotations

import time
from functools import partial
from typing import Any, ClassVar

from ctrl_rl_core.ros import DIAGNOSTICS, LATCHED, Status, ok
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

from ctrl_rl_bringup.view.page import Page, ReleaseStop, Request, SendGoal, StopRobot, UsePolicy
from ctrl_rl_bringup.view.reading import SceneReader
from ctrl_rl_bringup.view.scene import PERIOD_S, Scene
from ctrl_rl_bringup.view.value_slice import ValueSlice
from ctrl_rl_core import COMMAND, RESULT, SENSOR, OccupancyMap, Parameter, Robot, SuiteNode
from ctrl_rl_msgs.msg import LatentState, NavigatorStatus, SafetyStatus

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # an install by wheels that was built without it
    TFMessage = None

_MOVING = QoSProfile(depth=100)
_FIXED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
VIEW_PARAMETERS = (
    Parameter("enable_stamped_cmd_vel", True, "Commands are TwistStamped (Jazzy), else Twist (Humble)."),
    Parameter("map_frame", "map", "Frame of the map, in which everything is shown.", kind="name"),
)


class ViewNode(SuiteNode):
    """Shows a robot in a browser.

    Subscribes to the robot's sensors and commands, to map, path, slice and status of the navigator, to set, escape and
    status of the safety filter, and to /diagnostics. On request it publishes goal_pose and emergency_stop, calls
    navigator/cancel, and sets the parameter `policy` of the node policy.
    """

    PARAMETERS = VIEW_PARAMETERS
    SHARED_MEMORY: ClassVar[bool] = False
    """A page is closed by killing it; what it shared with a driving node would freeze that node."""

    def __init__(
        self, page: Page, robot: Robot, value: ValueSlice | None = None, map_: OccupancyMap | None = None
    ) -> None:
        super().__init__("view")
        self._page, self._value, self._scene = page, value, Scene(map=map_)
        self._reader = SceneReader(self._scene, robot, self.settings["map_frame"].lstrip("/"), value is None)
        self._goal = self.create_publisher(PoseStamped, "goal_pose", 10)
        self._emergency = self.create_publisher(Bool, "emergency_stop", COMMAND)
        self._cancel = self.create_client(Trigger, "navigator/cancel")
        self._policy = self.create_client(SetParameters, "policy/set_parameters")
        self._served, self._begin = 0, time.monotonic()
        for name, (kind, qos) in _topics(self.settings["enable_stamped_cmd_vel"]).items():
            if kind is not None:
                self.create_subscription(kind, name, partial(self._take, name), qos)
        self.create_timer(PERIOD_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def status(self) -> Status:
        """Report the frames a second and the number of requests served."""
        rate = self._page.frames / max(time.monotonic() - self._begin, 1e-3)
        return ok("showing", **{"frames a second": f"{rate:.1f}", "requests": self._served})

    def stop(self) -> None:
        """Close the page."""
        self._page.close()

    def _take(self, name: str, message: Any) -> None:
        self._reader.take(name, message, time.monotonic())

    def _tick(self) -> None:
        for request in self._page.take_requests():
            self._served += 1
            self._serve(request)
        self._reader.update_pose()
        if self._value is not None:
            self._scene.value = self._value.at(self._scene.pose[2] if self._scene.pose else 0.0)
        self._page.draw(self._scene)

    def _serve(self, request: Request) -> None:
        match request:
            case SendGoal(x, y):
                self._send_goal(x, y)
            case StopRobot():
                self._stop_robot()
            case ReleaseStop():
                self._emergency.publish(Bool(data=False))
                self._scene.say("page", "emergency stop released")
            case UsePolicy(name):
                value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=name)
                self._call(
                    self._policy,
                    SetParameters.Request(parameters=[ParameterMsg(name="policy", value=value)]),
                    f"policy {name}",
                )

    def _send_goal(self, x: float, y: float) -> None:
        goal = PoseStamped()
        goal.header.frame_id, goal.header.stamp = self.settings["map_frame"], self.get_clock().now().to_msg()
        goal.pose.position.x, goal.pose.position.y = x, y
        goal.pose.orientation.w = 0.0  # any heading
        self._goal.publish(goal)
        heard = self._goal.get_subscription_count() > 0
        words = f"goal ({x:.2f}, {y:.2f}) sent" if heard else "the goal reaches nobody: no navigator hears goal_pose"
        self._scene.say("page", words, 0 if heard else 2)

    def _stop_robot(self) -> None:
        """Cancel the navigator's goal, and lock twist_mux where there is one."""
        locks = self._emergency.get_subscription_count() > 0
        if locks:
            self._emergency.publish(Bool(data=True))
        if locks and not self._cancel.service_is_ready():
            self._scene.say("page", "emergency stop")
            return
        self._call(self._cancel, Trigger.Request(), "emergency stop" if locks else "stop")

    def _call(self, client: Any, request: Any, words: str) -> None:
        """Call a service, and show the answer."""
        if not client.service_is_ready():
            self._scene.say("page", f"{words}: nobody answers on {client.srv_name}", 2)
            return
        self._scene.say("page", f"{words}: asked")
        client.call_async(request).add_done_callback(partial(self._on_answer, words))

    def _on_answer(self, words: str, future: Any) -> None:
        answer = future.result()
        results = getattr(answer, "results", None)  # of SetParameters
        good = results[0].successful if results else getattr(answer, "success", False)
        reason = results[0].reason if results else getattr(answer, "message", "")
        self._scene.say("page", f"{words}: {reason or ('done' if good else 'refused')}", 0 if good else 1)


def _topics(stamped: bool) -> dict[str, tuple[Any, QoSProfile]]:
    """Return type and quality of service of each topic; the type is None where ROS has it not."""
    twist = TwistStamped if stamped else Twist
    return {
        "/tf": (TFMessage, _MOVING),
        "/tf_static": (TFMessage, _FIXED),
        DIAGNOSTICS: (DiagnosticArray, QoSProfile(depth=10)),
        "odom": (Odometry, SENSOR),
        "scan": (LaserScan, SENSOR),
        "map": (OccupancyGrid, LATCHED),
        "path": (Path, LATCHED),
        "cmd_vel_raw": (twist, COMMAND),
        "cmd_vel": (twist, COMMAND),
        "navigator/slice": (OccupancyGrid, LATCHED),
        "navigator/status": (NavigatorStatus, LATCHED),
        "safety_filter/set": (OccupancyGrid, LATCHED),
        "safety_filter/escape": (Marker, QoSProfile(depth=1)),
        "safety_filter/status": (SafetyStatus, RESULT),
        "koopman_lqr_controller/latent": (LatentState, RESULT),
    }
