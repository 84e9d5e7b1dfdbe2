"""A node whose callbacks fail as configured by its parameters, run as a process by tests of faults and startup.

Options besides ROS's: --drives for a node that may share no memory, --slow for rclpy's usual executor,
--without-events for an rclpy that has no other, --stuck for a constructor that takes a minute.
"""

import sys
import time

if "--without-events" in sys.argv:
    sys.modules["rclpy.experimental"] = None

from ctrl_rl_core.ros.node import ok
from ctrl_rl_core.ros.stop_request import interruptible
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ctrl_rl_core import CtrlRlError, Parameter, SuiteNode, run_node

OPTIONS = {name: name in sys.argv for name in ("--slow", "--stuck", "--without-events", "--drives")}


def work(seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(0.01)


class FatalError(CtrlRlError):
    """The work cannot continue."""


class FailingNode(SuiteNode):
    """Raises in each of its callbacks when the topic `say` requests it, and repeats other messages on `heard`."""

    FATAL = (FatalError,)
    PARAMETERS = (
        Parameter("broken", False, "Whether the timer raises.", live=True),
        Parameter("value", 1.0, "Refused by an unexpected error where it is negative.", live=True),
        Parameter("text", "", "'crash' for a constructor that raises."),
        Parameter("file", "", "A file.", kind="path"),
        Parameter("name", "", "A name of ROS.", kind="name"),
        Parameter("names", [""], "Names of ROS.", kind="name"),
        Parameter("fatal", False, "Whether the timer raises what ends the node.", live=True),
    )

    def __init__(self) -> None:
        super().__init__("failing")
        if OPTIONS["--stuck"]:
            self.get_logger().info("works")
            work(60.0)
        self._heard = self.create_publisher(String, "heard", 100)
        self.create_subscription(String, "say", self._on_say, 100)
        self.create_subscription(String, "say_error", self._on_say_error, 100)
        self.create_service(Trigger, "~/trigger", self._on_trigger)
        self.create_timer(0.01, self._on_timer)
        self._status_fails = False
        if self.settings["text"] == "crash":
            raise LookupError("nothing of the kind")
        self.get_logger().info("text {text!r}, names {names!r}, file {file!r}".format(**self.settings))
        self.get_logger().info("runs")

    def on_callback_error(self, error):
        self._heard.publish(String(data=f"stands: {error}"))

    def on_parameter_changed(self, name):
        if name == "value" and self.settings["value"] < 0.0:
            raise ZeroDivisionError("an unexpected end")

    def status(self):
        if self._status_fails:
            raise KeyError("figures")
        return ok("fine")

    def _on_say(self, message):
        match message.data:
            case "raise":
                raise ValueError("a word too many\nand a second line")
            case "status":
                self._status_fails = not self._status_fails
            case "load":
                self.get_logger().info("loads")
                with interruptible():
                    work(60.0)
            case "exit":
                raise SystemExit(7)
            case _:
                self._heard.publish(message)

    def _on_say_error(self, message):
        if message.data:
            raise CtrlRlError(message.data)

    def _on_trigger(self, _request, _response):
        raise RuntimeError("no answer")

    def _on_timer(self):
        if self.settings["broken"]:
            raise IndexError("out of ticks")
        if self.settings["fatal"]:
            raise FatalError("the work is over")


def main() -> int:
    FailingNode.SHARED_MEMORY = not OPTIONS["--drives"]
    FailingNode.QUICK = not OPTIONS["--slow"]
    return run_node(FailingNode, [argument for argument in sys.argv if argument not in OPTIONS])


if __name__ == "__main__":
    sys.exit(main())
