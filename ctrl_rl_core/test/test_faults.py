"""Callbacks that raise: no node ends by them, and everybody is told. On real processes, under both executors."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import ListParameters, SetParameters, SetParametersAtomically
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

HERE = Path(__file__).parent
pytestmark = pytest.mark.fault


class Failing:
    """The failing node as a process, and a node that talks to it."""

    def __init__(self, log: Path, *arguments: str) -> None:
        self._log = log
        with log.open("wb") as stream:
            command = [sys.executable, HERE / "failing_node.py", *arguments]
            self.process = subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT)
        self.node = Node("outsider")
        self.heard: list[str] = []
        self.statuses: list[DiagnosticStatus] = []
        self.say_to = self.node.create_publisher(String, "say", 100)
        self.node.create_subscription(String, "heard", lambda m: self.heard.append(m.data), 100)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", lambda m: self.statuses.extend(m.status), 10)
        self.wait(lambda: self.say_to.get_subscription_count() and self.node.count_publishers("heard"))

    @property
    def output(self) -> str:
        return self._log.read_text()

    def wait(self, condition: Callable[[], object], timeout: float = 30.0) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, (self.output, self.heard, self.statuses[-1:])
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def say(self, *words: str) -> None:
        for word in words:
            self.say_to.publish(String(data=word))

    def lives(self) -> None:
        """Check that it still answers."""
        self.say("still there?")
        self.wait(lambda: "still there?" in self.heard)
        assert self.process.poll() is None
        self.heard.clear()

    def call(self, kind, name: str, request):
        client = self.node.create_client(kind, name)
        self.wait(client.service_is_ready)
        future = client.call_async(request)
        self.wait(future.done)
        return future.result()

    def set(self, name: str, value: ParameterValue):
        request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
        return self.call(SetParameters, "failing/set_parameters", request).results[0]

    def figure(self, name: str) -> str:
        return {each.key: each.value for each in self.statuses[-1].values}.get(name, "") if self.statuses else ""


@pytest.fixture(
    params=[(), ("--slow",), ("--without-events",)], ids=["events", "single-threaded", "without events executor"]
)
def failing(request, tmp_path: Path) -> Iterator[Failing]:
    rclpy.init()
    out = Failing(tmp_path / "log", *request.param)
    yield out
    if out.process.poll() is None:
        out.process.terminate()
        out.process.wait(120.0)
    out.node.destroy_node()
    rclpy.try_shutdown()


def test_a_failing_subscription_is_survived_and_said_in_one_line(failing: Failing) -> None:
    failing.say("raise")
    failing.wait(lambda: any(said.startswith("stands: a word too many") for said in failing.heard))
    failing.lives()
    failing.wait(lambda: failing.figure("failed callbacks") == "1")
    assert failing.figure("last failure") == "_on_say (say): ValueError: a word too many and a second line"
    assert failing.statuses[-1].level == DiagnosticStatus.ERROR
    assert "callback failed: _on_say (say): ValueError" in failing.output
    assert "Traceback" not in failing.output


def test_the_suites_own_errors_do_not_end_it_either(failing: Failing) -> None:
    failing.say("suite error")
    failing.lives()
    assert "callback failed: _on_say (say): the suite's own" in failing.output


def test_a_timer_that_fails_for_ever_is_counted_and_does_not_flood(failing: Failing) -> None:
    assert failing.set("broken", ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True)).successful
    failing.wait(lambda: int(failing.figure("failed callbacks") or 0) > 50)
    failing.lives()
    assert failing.output.count("out of ticks") < 5
    assert failing.set("broken", ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=False)).successful
    failing.statuses.clear()
    failing.wait(lambda: any(status.level == DiagnosticStatus.OK for status in failing.statuses))


def test_a_failing_service_is_answered(failing: Failing) -> None:
    answer = failing.call(Trigger, "failing/trigger", Trigger.Request())
    assert (answer.success, answer.message) == (False, "RuntimeError: no answer")
    failing.lives()


def test_a_status_that_fails_is_said(failing: Failing) -> None:
    failing.say("status")
    failing.wait(lambda: failing.figure("last failure") == "status: KeyError: 'figures'")
    failing.lives()


def test_a_parameter_that_fails_unexpectedly_is_refused(failing: Failing) -> None:
    minus = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=-1.0)
    answer = failing.set("value", minus)
    assert not answer.successful
    assert "an unexpected end" in answer.reason
    failing.lives()


def test_a_parameter_of_unknown_type_is_refused_and_counted(failing: Failing) -> None:
    answer = failing.set("value", ParameterValue(type=77))
    assert not answer.successful
    assert "unknown type 77" in answer.reason
    request = SetParametersAtomically.Request(parameters=[Parameter(name="value", value=ParameterValue(type=77))])
    assert not failing.call(SetParametersAtomically, "failing/set_parameters_atomically", request).result.successful
    good = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=2.0)
    assert failing.set("value", good).successful
    names = failing.call(ListParameters, "failing/list_parameters", ListParameters.Request()).result.names
    assert "value" in names
    failing.wait(lambda: failing.figure("refused parameter requests") == "2")
    failing.lives()


def test_a_fatal_error_ends_it_with_one_line(failing: Failing) -> None:
    failing.set("fatal", ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True))
    assert failing.process.wait(120.0) == 1
    assert failing.output.strip().splitlines()[-1] == "failing_node.py: the work is over"


def test_a_signal_cuts_off_what_a_callback_loads(failing: Failing) -> None:
    failing.say("load")
    failing.wait(lambda: "loads" in failing.output)
    failing.process.send_signal(signal.SIGINT)
    assert failing.process.wait(120.0) == 0
    assert "Traceback" not in failing.output


def test_the_executor_is_said(failing: Failing) -> None:
    failing.wait(lambda: failing.figure("executor") in ("EventsExecutor", "SingleThreadedExecutor"))


def test_it_may_still_exit_by_itself(failing: Failing) -> None:
    failing.say("exit")
    assert failing.process.wait(120.0) == 7
