"""A node whose callbacks raise what its parameters say, run as a process by test_faults.py."""

import sys

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.parameters import Parameter
from ctrl_rl_core.ros import SuiteNode, ok, run_node
from std_msgs.msg import String
from std_srvs.srv import Trigger


class FatalError(CtrlRlError):
    """The work cannot go on."""


class FailingNode(SuiteNode):
    """Raises in each of its callbacks when the topic `say` says so, and repeats on `heard` what else it hears."""

    FATAL = (FatalError,)
    PARAMETERS = (
        Parameter("broken", False, "Whether the timer raises.", live=True),
        Parameter("value", 1.0, "Refused by an unexpected error where it is negative.", live=True),
        Parameter("fatal", False, "Whether the timer raises what ends the node.", live=True),
    )

    def __init__(self) -> None:
        super().__init__("failing")
        self._heard = self.create_publisher(String, "heard", 100)
        self.create_subscription(String, "say", self._on_say, 100)
        self.create_service(Trigger, "~/trigger", self._on_trigger)
        self.create_timer(0.01, self._on_timer)
        self._status_fails = False
        self.get_logger().info("runs")

    def callback_failed(self, error):
        self._heard.publish(String(data=f"stands: {error}"))

    def setting_changed(self, name):
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
            case "suite error":
                raise CtrlRlError("the suite's own")
            case "status":
                self._status_fails = True
            case "exit":
                raise SystemExit(7)
            case _:
                self._heard.publish(message)

    def _on_trigger(self, _request, _response):
        raise RuntimeError("no answer")

    def _on_timer(self):
        if self.settings["broken"]:
            raise IndexError("out of ticks")
        if self.settings["fatal"]:
            raise FatalError("the work is over")


class FailingSlowNode(FailingNode):
    """The same under rclpy's usual executor."""

    QUICK = False


if __name__ == "__main__":
    sys.exit(run_node(FailingSlowNode if "--slow" in sys.argv and not sys.argv.remove("--slow") else FailingNode))
