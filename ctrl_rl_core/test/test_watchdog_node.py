"""The watchdog: commands pass, and zeros replace them when they stop because of a kill, a freeze or silence."""

import itertools
import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from command_source import SPEED
from ctrl_rl_core.driving.watchdog_node import WatchdogNode
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from preloaded import Preloaded
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from ctrl_rl_core import COMMAND
from ctrl_rl_msgs.msg import RotorThrusts

PATIENCE_S = 120.0
QUICK = ("timeout:=0.3", "zero_rate:=20.0")
SHARED = ("--topic", "/shared/cmd_vel_raw")


class Base:
    """The robot's side: messages on cmd_vel, and the status of the namespace's watchdog."""

    def __init__(self, kind: type = TwistStamped, namespace: str = "") -> None:
        self.node = Node("base", namespace=namespace)
        self._watchdog = f"{namespace}/watchdog"
        self.kind = kind
        self.speeds: list[float] = []
        self.stamps: list[float] = []
        self.said: DiagnosticStatus | None = None
        self.node.create_subscription(kind, "cmd_vel", self._on_command, COMMAND)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.raw = self.node.create_publisher(kind, "cmd_vel_raw", COMMAND)

    def _on_command(self, message: TwistStamped | Twist) -> None:
        self.speeds.append((message.twist if self.kind is TwistStamped else message).linear.x)
        if self.kind is TwistStamped:
            self.stamps.append(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        if message.status[0].name == self._watchdog:
            self.said = message.status[0]

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, (self.speeds[-10:], self.said)
            rclpy.spin_once(self.node, timeout_sec=0.02)

    @property
    def drives(self) -> bool:
        return bool(self.speeds) and self.speeds[-1] == SPEED

    @property
    def stands(self) -> bool:
        return bool(self.speeds) and self.speeds[-1] == 0.0

    def says(self, words: str) -> Callable[[], bool]:
        return lambda: self.said is not None and words in self.said.message

    def command(self, speed: float, turn: float = 0.0, stamp: float = 0.0) -> None:
        message = self.kind()
        if self.kind is TwistStamped:
            message.header.stamp.sec, message.header.stamp.nanosec = int(stamp), int(stamp % 1.0 * 1e9)
        twist = message.twist if self.kind is TwistStamped else message
        twist.linear.x, twist.angular.z = speed, turn
        self.raw.publish(message)

    def close(self) -> None:
        self.node.destroy_node()


@pytest.fixture(scope="module", autouse=True)
def _ros(_no_shared_memory: None) -> Iterator[None]:
    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.fixture
def base() -> Iterator[Base]:
    out = Base()
    yield out
    out.close()


@pytest.fixture(scope="module")
def shared(run_shared_node: Callable) -> Iterator[tuple[Base, Any]]:
    """A base and its watchdog, for tests that leave the watchdog unchanged."""
    watchdog = run_shared_node("ctrl_rl_core", "watchdog", *QUICK, "repeat_for:=0.0", remap=("__ns:=/shared",))
    base = Base(namespace="/shared")
    base.until(lambda: base.raw.get_subscription_count() > 0)
    yield base, watchdog
    base.close()


@pytest.fixture
def still(shared: tuple[Base, Any]) -> Base:
    """The shared base at rest, after the driver of the previous test is gone."""
    base, _ = shared
    base.speeds.clear()
    base.until(lambda: base.speeds[-5:] == [0.0] * 5)
    base.speeds.clear()
    base.stamps.clear()
    base.said = None
    base.until(lambda: base.stands)
    return base


@pytest.fixture
def source() -> Iterator[Callable[..., subprocess.Popen]]:
    started: list[subprocess.Popen] = []

    def start(*arguments: str) -> subprocess.Popen:
        script = Path(__file__).with_name("command_source.py")
        started.append(Preloaded([sys.executable, script, *arguments]))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.fault
def test_a_driver_that_is_killed_leaves_the_robot_standing_and_a_new_one_drives_on(
    still: Base, source: Callable
) -> None:
    driver = source(*SHARED)
    still.until(lambda: still.drives)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    still.until(lambda: still.stands)
    still.until(still.says("no usable command on /shared/cmd_vel_raw for"))
    assert still.stands
    source(*SHARED)
    still.until(lambda: still.drives)
    still.until(still.says("passing commands on"))


@pytest.mark.fault
def test_a_driver_that_is_frozen_leaves_the_robot_standing(still: Base, source: Callable) -> None:
    driver = source(*SHARED)
    still.until(lambda: still.drives)
    driver.send_signal(signal.SIGSTOP)
    still.until(lambda: still.stands)
    driver.send_signal(signal.SIGCONT)
    still.until(lambda: still.drives)


@pytest.mark.fault
def test_a_driver_that_says_nothing_leaves_the_robot_standing_though_its_process_lives(
    still: Base, source: Callable
) -> None:
    driver = source(*SHARED, "--commands", "40")
    still.until(lambda: still.drives)
    still.until(lambda: still.stands)
    assert driver.poll() is None


@pytest.mark.fault
def test_it_stops_on_wall_time_where_the_simulated_clock_stands_still(
    base: Base, run_node: Callable, source: Callable
) -> None:
    clock = base.node.create_publisher(Clock, "/clock", 1)
    run_node("ctrl_rl_core", "watchdog", *QUICK, "use_sim_time:=true")
    base.until(lambda: clock.get_subscription_count() > 0)
    clock.publish(Clock())
    driver = source()
    base.until(lambda: base.drives)
    driver.kill()
    base.until(lambda: base.stands)


@pytest.mark.fault
def test_numbers_that_make_no_sense_become_zero_and_it_says_why(still: Base, shared: tuple[Base, Any]) -> None:
    _, watchdog = shared
    for speed, turn, words in (
        (math.nan, 0.0, "linear.x is nan"),
        (0.1, -math.inf, "angular.z is -inf"),
        (1e308, 0.0, "linear.x is 1e+308, more than largest_speed 0.22"),
    ):
        still.speeds.clear()
        still.command(speed, turn)
        still.until(lambda: still.stands)
        still.until(still.says(words))
        assert set(still.speeds) == {0.0}
    still.command(0.1)
    still.until(lambda: 0.1 in still.speeds)
    watchdog.wait_for("zero instead of a command: linear.x is nan")


@pytest.mark.fault
def test_after_its_own_freeze_it_stops_the_robot_first(base: Base, run_node: Callable, source: Callable) -> None:
    watchdog = run_node("ctrl_rl_core", "watchdog", *QUICK)
    driver = source()
    base.until(lambda: base.drives)
    watchdog.process.send_signal(signal.SIGSTOP)
    driver.kill()
    deadline = time.monotonic() + 1.0
    base.until(lambda: time.monotonic() > deadline)
    base.speeds.clear()
    watchdog.process.send_signal(signal.SIGCONT)
    base.until(lambda: base.stands)
    assert set(base.speeds) == {0.0}, "the command that waited is too old"


@pytest.mark.fault
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGALRM])
def test_stopped_itself_it_leaves_the_robot_standing(
    base: Base, run_node: Callable, source: Callable, number: int
) -> None:
    watchdog = run_node("ctrl_rl_core", "watchdog", "timeout:=60.0")
    source()
    base.until(lambda: base.drives)
    code, _ = watchdog.stop(number)
    assert code == 0, watchdog.output
    base.until(lambda: base.stands)


@pytest.mark.fault
def test_it_warns_of_whoever_drives_the_robot_past_it(still: Base, shared: tuple[Base, Any], source: Callable) -> None:
    _, watchdog = shared
    still.until(lambda: still.said is not None)
    rival = source("--topic", "/shared/cmd_vel", "--name", "teleop")
    still.until(still.says("/teleop publishes on /shared/cmd_vel too"))
    assert still.said is not None
    assert still.said.level == DiagnosticStatus.WARN
    watchdog.wait_for("/teleop publishes on /shared/cmd_vel too, past this watchdog")
    rival.send_signal(signal.SIGINT)
    still.until(lambda: still.said is not None and "/teleop" not in still.said.message)


class _Faulty(WatchdogNode):
    """A watchdog whose timer fails, so that it would not notice silence."""

    def _tick(self) -> None:
        raise RuntimeError("out of memory")


@pytest.mark.fault
def test_a_watchdog_that_fails_itself_lets_the_robot_stand(base: Base) -> None:
    watchdog = _Faulty()
    executor = SingleThreadedExecutor()
    for node in (watchdog, base.node):
        executor.add_node(node)
    try:
        deadline = time.monotonic() + PATIENCE_S
        while watchdog.faults.count < 5 or base.raw.get_subscription_count() == 0:
            assert time.monotonic() < deadline
            executor.spin_once(timeout_sec=0.05)
        while "a callback failed: " not in watchdog.status()[1]:
            assert time.monotonic() < deadline
            base.command(SPEED)
            executor.spin_once(timeout_sec=0.05)
        assert set(base.speeds) == {0.0}
    finally:
        executor.shutdown()
        watchdog.destroy_node()


def test_a_source_of_the_wrong_type_is_named(base: Base, run_node: Callable) -> None:
    run_node("ctrl_rl_core", "watchdog", "enable_stamped_cmd_vel:=false")
    base.until(base.says("/base (geometry_msgs/msg/TwistStamped) is ignored: set enable_stamped_cmd_vel to match it"))


def test_plain_twists_pass_where_the_robot_is_older(run_node: Callable) -> None:
    base = Base(Twist)
    try:
        run_node("ctrl_rl_core", "watchdog", *QUICK, "enable_stamped_cmd_vel:=false")
        base.until(lambda: base.raw.get_subscription_count() > 0 and base.stands)
        base.command(0.1, 0.2)
        base.until(lambda: 0.1 in base.speeds)
        base.until(lambda: base.stands)
    finally:
        base.close()


def test_it_starts_without_the_heavy_libraries() -> None:
    """A robot that has lost its watchdog waits for the next one."""
    code = "import sys, ctrl_rl_core.driving.watchdog_node; print(sorted({'numba', 'scipy'} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


@pytest.mark.parametrize("behind", [5.0, -5.0])
def test_zeros_are_stamped_by_the_clock_of_the_commands(still: Base, behind: float) -> None:
    """Between commands with the stamp of a scan or of another computer, a zero does not set the clock back."""

    def driven() -> bool:
        still.command(SPEED, stamp=time.time() - behind)
        return still.drives

    still.until(driven)
    first = still.speeds.index(SPEED)
    still.until(lambda: still.stands and still.speeds[-3:] == [0.0] * 3)
    still.until(driven)
    stamps = still.stamps[first:]
    assert all(later - earlier > -0.5 for earlier, later in itertools.pairwise(stamps))


@pytest.mark.parametrize("stamp", [0.0, 2.0**31 - 1.0])
def test_a_zero_follows_a_command_of_any_stamp(still: Base, stamp: float) -> None:

    def driven() -> bool:
        still.command(SPEED, stamp=stamp)
        return still.drives

    still.until(driven)
    still.until(lambda: still.stands)


@pytest.mark.fault
def test_a_quadrotor_without_a_pilot_hovers_then_its_rotors_stop(run_node: Callable) -> None:
    node, thrusts, said = Node("quadrotor"), list[tuple[float, float]](), list[str]()
    node.create_subscription(RotorThrusts, "rotor_thrusts", lambda got: thrusts.append((got.t1, got.t2)), COMMAND)
    node.create_subscription(DiagnosticArray, "/diagnostics", lambda got: said.append(got.status[0].message), 10)
    raw = node.create_publisher(RotorThrusts, "rotor_thrusts_raw", COMMAND)

    def until(condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, (thrusts[-10:], said[-2:])
            rclpy.spin_once(node, timeout_sec=0.02)

    def told(words: str) -> Callable[[], bool]:
        return lambda: bool(said) and words in said[-1]

    try:
        watchdog = run_node("ctrl_rl_core", "thrust_watchdog", "timeout:=0.3", "rest_thrust:=6.0", "hover_for:=2.5")
        until(told("no usable command yet on /rotor_thrusts_raw"))
        assert thrusts == [], "before its first command a quadrotor on the ground stays there"
        until(lambda: node.count_publishers("rotor_thrusts") == 1 and raw.get_subscription_count() == 1)

        def flies() -> bool:
            raw.publish(RotorThrusts(t1=7.0, t2=6.5))
            return (7.0, 6.5) in thrusts

        until(flies)
        until(lambda: thrusts[-1] == (6.0, 6.0))
        until(told("each rotor pair gives 6 N"))
        until(lambda: thrusts[-1] == (0.0, 0.0))
        until(told("the rotors are stopped"))
        thrusts.clear()
        until(flies)
        rest = {(6.0, 6.0), (0.0, 0.0)}
        for t1 in (math.nan, -1.0, 16.0):
            thrusts.clear()
            raw.publish(RotorThrusts(t1=t1))
            until(lambda: not rest.isdisjoint(thrusts))
            assert set(thrusts) <= {*rest, (7.0, 6.5)}, "commands of before may still arrive"
        watchdog.wait_for("rest thrust instead of a command: t1 is nan N")
    finally:
        node.destroy_node()


@pytest.mark.fault
def test_two_watchdogs_on_one_robot_both_stand_and_name_each_other(
    base: Base, run_node: Callable, source: Callable
) -> None:
    """Started by two launch files: one behind a filter that sends nothing, one behind the driver itself."""
    one = run_node("ctrl_rl_core", "watchdog", *QUICK)
    source()
    base.until(lambda: base.drives)
    other = run_node("ctrl_rl_core", "watchdog", *QUICK, remap=("cmd_vel_raw:=cmd_vel_safe",))
    one.wait_for("/watchdog publishes on /cmd_vel too")
    base.speeds.clear()
    deadline = time.monotonic() + 2.0
    base.until(lambda: time.monotonic() > deadline and len(base.speeds) > 5)
    assert set(base.speeds) == {0.0}
    other.stop()
    base.until(lambda: base.drives)


@pytest.mark.fault
def test_before_it_is_suspended_it_leaves_the_robot_standing(base: Base, run_node: Callable, source: Callable) -> None:
    watchdog = run_node("ctrl_rl_core", "watchdog", "timeout:=60.0")
    source()
    base.until(lambda: base.drives)
    watchdog.process.send_signal(signal.SIGTSTP)  # Ctrl-Z
    stat = Path(f"/proc/{watchdog.process.pid}/stat")
    base.until(lambda: stat.read_text().rpartition(")")[2].split()[0] == "T")
    base.until(lambda: base.stands)
    watchdog.process.send_signal(signal.SIGCONT)
    base.until(lambda: base.drives)
