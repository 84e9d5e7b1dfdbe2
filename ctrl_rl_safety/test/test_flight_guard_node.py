"""The flight guard as a real node between a pilot, a real watchdog and the simulator: passing and every fault."""

import math
import signal
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from room import shifted
from std_srvs.srv import SetBool

from ctrl_rl_core import COMMAND, RESULT, SENSOR, load_navigation_task
from ctrl_rl_msgs.msg import EpisodeStatus, FlightStatus, RotorThrusts, TaskOutcome
from ctrl_rl_msgs.srv import ResetWorld, StepWorld
from ctrl_rl_safety import quadrotor_of

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("_no_shared_memory")]  # some are killed
MODEL = quadrotor_of(load_navigation_task("quad_trap"))
REST = 0.5 * MODEL.mass * MODEL.gravity
FULL = (MODEL.most, MODEL.most)


_RATE = 120.0
"""Rate of odometry [Hz]."""
_EVERY = 6
"""Odometry messages per pair of raw thrusts."""
_DUE = 0.02
"""Time after an answer from which odometry must be answered; the guard's period is 0.025 [s]."""


class Pilot:
    """Pilot that sends raw thrusts at 20 Hz and forwards odometry from the simulator to the guard, with faults.

    Attributes:
        raw: Thrusts T_1 and T_2 that are sent; None for none.
        odometry: Modifier of odometry before it is forwarded; returns None to drop it.
        told: Messages of the guard.
        thrusts: Thrusts received by the simulator.
        episode: Last state of the episode.
        pose: Last position x and z [m] and velocity [m/s] in the simulator's odometry.
    """

    def __init__(self) -> None:
        simulated = Parameter("use_sim_time", Parameter.Type.BOOL, True)
        self.node = rclpy.create_node("pilot", parameter_overrides=[simulated])
        self.raw: tuple[float, float] | None = None
        self.odometry: Callable[[Odometry], Odometry | None] = lambda odometry: odometry
        self.told: list[FlightStatus] = []
        self.thrusts: list[tuple[float, float]] = []
        self.episode = EpisodeStatus()
        self.pose = (math.nan, math.nan, math.nan)
        self._heard, self._stamp = 0, 0.0
        make, listen = self.node.create_publisher, self.node.create_subscription
        self._raw, self._odometry = make(RotorThrusts, "rotor_thrusts_raw", COMMAND), make(Odometry, "odom", 10)
        listen(Odometry, "simulated_odom", self._on_odometry, SENSOR)
        listen(FlightStatus, "flight_guard/status", self.told.append, RESULT)
        listen(RotorThrusts, "rotor_thrusts", lambda got: self.thrusts.append((got.t1, got.t2)), COMMAND)
        listen(EpisodeStatus, "episode", self._on_episode, RESULT)
        self._reset = self.node.create_client(ResetWorld, "sim_bridge/reset")
        self._pause = self.node.create_client(SetBool, "sim_bridge/pause")
        self._step = self.node.create_client(StepWorld, "sim_bridge/step")

    def until(self, fits: Callable[[], bool], timeout: float = 120.0) -> None:
        """Run until a condition holds."""
        deadline = time.monotonic() + timeout
        while not fits():
            rclpy.spin_once(self.node, timeout_sec=0.005)
            assert time.monotonic() < deadline, (self.told[-1:], self.thrusts[-1:], self.pose, self.episode)

    def until_told(self, mode: int, why: str = "") -> FlightStatus:
        """Run until the guard reports a mode in a new message, with given text in its reason."""
        self.told.clear()
        self.until(lambda: any(each.mode == mode and why in each.why for each in self.told))
        return next(each for each in self.told if each.mode == mode and why in each.why)

    def begin(self) -> None:
        """Start another flight, with hover thrusts from the pilot."""
        self.raw, self.odometry = (REST, REST), lambda odometry: odometry
        self.pause(False)
        episode = self._answer_of(self._reset, ResetWorld.Request(seed=1)).episode
        self.until(lambda: self.episode.episode == episode)
        self.told.clear()
        self.until(lambda: any(each.mode == FlightStatus.PASSED and each.raw_t1 == REST for each in self.told))

    def pause(self, paused: bool) -> None:
        """Pause or resume the simulation."""
        assert self._answer_of(self._pause, SetBool.Request(data=paused)).success

    def step(self) -> None:
        """Advance a paused simulation to the next odometry, and wait if the guard must answer it."""
        heard = self._heard
        assert self._answer_of(self._step, StepWorld.Request(duration=1.0 / _RATE)).success
        self.until(lambda: self._heard > heard)
        self.until(lambda: self._stamp - _seconds(self.told[-1].header.stamp) <= _DUE)
        self.until(lambda: self.thrusts[-1] == (self.told[-1].t1, self.told[-1].t2))
        self.pause(True)  # an answer of the simulator's: it has the thrusts too

    def _answer_of(self, client: Any, request: Any) -> Any:
        self.until(client.service_is_ready)
        answer = client.call_async(request)
        self.until(answer.done)
        return answer.result()

    def _on_odometry(self, message: Odometry) -> None:
        position, speed = message.pose.pose.position, message.twist.twist.linear
        self.pose = position.x, position.z, math.hypot(speed.x, speed.z)
        self._heard, self._stamp = self._heard + 1, _seconds(message.header.stamp)
        if self.raw is not None and self._heard % _EVERY == 0:
            thrusts = RotorThrusts(t1=self.raw[0], t2=self.raw[1])
            thrusts.header.stamp = message.header.stamp
            self._raw.publish(thrusts)
        changed = self.odometry(message)
        if changed is not None:
            self._odometry.publish(changed)

    def _on_episode(self, message: EpisodeStatus) -> None:
        self.episode = message


def _seconds(stamp: Time) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


@pytest.fixture(scope="module")
def start_guard(run_shared_node: Callable[..., Any]) -> Callable[[], Any]:
    return lambda: run_shared_node(
        "ctrl_rl_safety",
        "flight_guard",
        "task:=quad_trap",
        "use_sim_time:=true",
        "hover_for:=0.6",
        remap=("rotor_thrusts:=rotor_thrusts_safe",),
    )


@pytest.fixture(scope="module")
def chain(start_guard: Callable[[], Any], run_shared_node: Callable[..., Any]) -> Iterator[SimpleNamespace]:
    """Return pilot and guard, connected to the simulator and the watchdog."""
    rclpy.init()
    pilot = Pilot()
    run_shared_node(
        "sim_bridge",
        "bridge",
        "task:=quad_trap",
        "engine:=planar",
        f"odom_rate:={_RATE}",
        "speed_factor:=0.15",
        remap=("odom:=simulated_odom",),
    )
    run_shared_node(
        "ctrl_rl_core",
        "thrust_watchdog",
        "timeout:=0.5",
        "hover_for:=0.0",
        f"rest_thrust:={REST}",
        f"largest_thrust:={MODEL.most}",
        remap=("rotor_thrusts_raw:=rotor_thrusts_safe",),
    )
    yield SimpleNamespace(pilot=pilot, guard=start_guard())
    pilot.node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def pilot(chain: SimpleNamespace) -> Pilot:
    chain.pilot.begin()
    return chain.pilot


def test_thrusts_pass_and_full_thrust_touches_nothing(pilot: Pilot) -> None:
    passed = pilot.until_told(FlightStatus.PASSED)
    assert (passed.t1, passed.t2) == (passed.raw_t1, passed.raw_t2) == (REST, REST)
    assert passed.room > 0.0
    assert passed.why == ""
    pilot.until(lambda: (REST, REST) in pilot.thrusts)
    pilot.pause(True)  # steps that wait for the answer: the guard promises nothing where thrusts arrive late
    pilot.raw = FULL
    del pilot.told[:-1]
    for _ in range(round(3.0 * _RATE)):
        pilot.step()
    changed = next(each for each in pilot.told if each.mode == FlightStatus.CORRECTED)
    assert (changed.t1, changed.t2) != FULL
    assert "leave no escape" in changed.why
    assert pilot.episode.outcome.value in (TaskOutcome.RUNNING, TaskOutcome.GOAL, TaskOutcome.TIMEOUT)
    assert pilot.episode.smallest_clearance > 0.0


@pytest.mark.fault
@pytest.mark.parametrize(
    ("raw", "why"),
    [
        (None, "no recent thrusts on /rotor_thrusts_raw"),
        ((math.nan, REST), f"raw thrusts of nan and {REST:g} N"),
        ((REST, -math.inf), f"raw thrusts of {REST:g} and -inf N"),
    ],
)
def test_without_usable_thrusts_it_brakes_hovers_and_hands_over(pilot: Pilot, raw: Any, why: str) -> None:
    pilot.raw = raw
    told = pilot.until_told(FlightStatus.WAITING, f"{why}: it brakes and hovers")
    assert math.isfinite(told.t1)
    pilot.until(lambda: pilot.pose[2] < 0.2)
    silent = pilot.until_told(FlightStatus.WAITING, "nothing is sent any more")
    assert math.isnan(silent.t1)
    pilot.thrusts.clear()
    pilot.until(lambda: pilot.thrusts[-3:] == [(REST, REST)] * 3)
    pilot.raw = (REST, REST)
    pilot.until_told(FlightStatus.PASSED)


def nowhere(odometry: Odometry) -> Odometry:
    odometry.pose.pose.position.x = math.nan
    return odometry


def unturned(odometry: Odometry) -> Odometry:
    odometry.pose.pose.orientation.w = odometry.pose.pose.orientation.y = 0.0
    return odometry


@pytest.mark.fault
@pytest.mark.parametrize(
    ("fault", "why"),
    [
        (lambda _: None, "no recent odometry"),
        (nowhere, "odometry with a translation of"),
        (unturned, "odometry with a quaternion of length"),
        (lambda odometry: shifted(odometry, -5.0), "odometry is"),
        (lambda odometry: shifted(odometry, 5.0), "ahead of this clock"),
    ],
)
def test_without_odometry_it_flies_the_last_escape_and_hands_over(
    chain: SimpleNamespace, pilot: Pilot, fault: Any, why: str
) -> None:
    pilot.raw = FULL
    pilot.until(lambda: pilot.pose[2] > 0.5)
    pilot.odometry = fault
    pilot.told.clear()
    pilot.until(lambda: any("nothing is sent any more" in each.why for each in pilot.told))
    flown = [each for each in pilot.told if why in each.why and "the last escape" in each.why]
    assert flown
    assert all(0.0 <= each.t1 <= MODEL.most for each in flown)
    assert pilot.pose[2] < 0.6, "the escape ends in a hover, by the simulator's own odometry"
    pilot.odometry = lambda odometry: odometry
    pilot.raw = (REST, REST)
    pilot.until_told(FlightStatus.PASSED)
    assert "callback failed" not in chain.guard.output


@pytest.mark.fault
def test_the_watchdog_takes_over_from_a_killed_guard_and_a_new_one_goes_on(
    chain: SimpleNamespace, start_guard: Callable[[], Any], pilot: Pilot
) -> None:
    pilot.raw = (1.02 * REST, 1.02 * REST)
    pilot.until(lambda: pilot.raw in pilot.thrusts)
    chain.guard.stop(signal.SIGKILL)
    pilot.thrusts.clear()
    pilot.until(lambda: pilot.thrusts[-3:] == [(REST, REST)] * 3)
    again = chain.guard = start_guard()
    pilot.until_told(FlightStatus.PASSED)
    code, _ = again.stop(signal.SIGTERM)
    assert code == 0
    assert "Traceback" not in again.output


@pytest.mark.parametrize(
    ("parameter", "words"),
    [
        ("task:=car_ttr", "task 'car_ttr' has no planar quadrotor"),
        ("task:=nowhere", "nowhere"),
        ("delay:=0.05", "parameter 'delay' is 0.05 s: at most the period 0.025 s"),
        ("mass:=9.0", "cannot hover"),
    ],
)
def test_what_it_cannot_guard_is_refused_in_one_line(run_node: Callable[..., Any], parameter: str, words: str) -> None:
    node = run_node("ctrl_rl_safety", "flight_guard", parameter)
    assert node.process.wait(120.0) != 0
    assert words in node.output
    assert "Traceback" not in node.output
