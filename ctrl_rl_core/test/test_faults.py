"""Failing callbacks do not end a node and are reported; tested on real processes with both executors."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from preloaded import Preloaded
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import ListParameters, SetParameters, SetParametersAtomically
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

HERE = Path(__file__).parent
pytestmark = pytest.mark.fault


class Failing:
    """The failing node as a process, and a node that communicates with it."""

    def __init__(self, log: Path, *arguments: str, namespace: str = "") -> None:
        self._log = log
        self._status_name = f"{namespace and '/'}{namespace}/failing"
        with log.open("wb") as stream:
            command = [sys.executable, HERE / "failing_node.py", *arguments]
            command += ["--ros-args", "-r", f"__ns:=/{namespace}"] if namespace else []
            self.process = Preloaded(command, stdout=stream, stderr=subprocess.STDOUT)
        self.node = Node("outsider", namespace=namespace)
        self.heard: list[str] = []
        self.statuses: list[DiagnosticStatus] = []
        self.say_to = self.node.create_publisher(String, "say", 100)
        self.node.create_subscription(String, "heard", lambda m: self.heard.append(m.data), 100)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.error_to = self.node.create_publisher(String, "say_error", 100)
        senders = (self.say_to, self.error_to)
        self.wait(lambda: all(each.get_subscription_count() for each in senders))
        self.wait(lambda: self.node.count_publishers("heard"))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.statuses += [status for status in message.status if status.name == self._status_name]

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
        """Check that the node still responds."""
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

    def failures(self) -> int:
        """Return the number of failed callbacks, from a status sent after this call."""
        self.statuses.clear()
        self.wait(lambda: self.statuses)
        return int(self.figure("failed callbacks") or 0)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(120.0)
        self.node.destroy_node()


@pytest.fixture(
    scope="module",
    params=[(), ("--slow",), ("--without-events",)],
    ids=["events", "single-threaded", "without events executor"],
)
def executor(request) -> Iterator[tuple[str, ...]]:
    """Options of an executor, while rclpy runs."""
    rclpy.init()
    yield request.param
    rclpy.try_shutdown()


@pytest.fixture(scope="module")
def failing(executor: tuple[str, ...], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Failing]:
    """One process for all tests that it survives."""
    out = Failing(tmp_path_factory.mktemp("failing") / "log", *executor)
    yield out
    out.close()


@pytest.fixture
def ending(executor: tuple[str, ...], tmp_path: Path) -> Iterator[Failing]:
    """A process for one test, which ends it; it has its own topics."""
    out = Failing(tmp_path / "log", *executor, namespace="ending")
    yield out
    out.close()


def test_a_failing_subscription_is_survived_and_said_in_one_line(failing: Failing) -> None:
    before = failing.failures()
    failing.say("raise")
    failing.wait(lambda: any(said.startswith("stands: a word too many") for said in failing.heard))
    failing.lives()
    failing.wait(lambda: failing.figure("failed callbacks") == str(before + 1))
    assert failing.figure("last failure") == "_on_say (say): ValueError: a word too many and a second line"
    assert failing.statuses[-1].level == DiagnosticStatus.ERROR
    assert "callback failed: _on_say (say): ValueError" in failing.output
    assert "Traceback" not in failing.output


def test_the_suites_own_errors_do_not_end_it_either(failing: Failing) -> None:
    failing.error_to.publish(String(data="the suite's own"))
    failing.wait(lambda: "callback failed: _on_say_error (say_error): the suite's own" in failing.output)
    failing.error_to.publish(String())  # it runs again
    failing.lives()


def test_a_timer_that_fails_for_ever_is_counted_and_does_not_flood(failing: Failing) -> None:
    assert failing.set("broken", ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True)).successful
    before = failing.failures()
    failing.wait(lambda: int(failing.figure("failed callbacks")) > before + 50)
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
    failing.say("status")
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
    failing.wait(lambda: failing.figure("refused parameter requests") == "2")  # no other test makes one
    failing.lives()


def test_a_fatal_error_ends_it_with_one_line(ending: Failing) -> None:
    ending.set("fatal", ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True))
    assert ending.process.wait(120.0) == 1
    assert ending.output.strip().splitlines()[-1] == "failing_node.py: the work is over"


def test_a_signal_cuts_off_what_a_callback_loads(ending: Failing) -> None:
    ending.say("load")
    ending.wait(lambda: "loads" in ending.output)
    ending.process.send_signal(signal.SIGINT)
    assert ending.process.wait(120.0) == 0
    assert "Traceback" not in ending.output


def test_the_executor_is_said(failing: Failing) -> None:
    failing.wait(lambda: failing.figure("executor") in ("EventsExecutor", "SingleThreadedExecutor"))


def test_it_may_still_exit_by_itself(ending: Failing) -> None:
    ending.say("exit")
    assert ending.process.wait(120.0) == 7
