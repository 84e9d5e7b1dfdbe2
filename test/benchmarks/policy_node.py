"""The policy node: latency against a bare echo, and the success of shipped policies against that in their environment.

    python test/benchmarks --only policy_node                                 # the latency
    python test/benchmarks/policy_node.py --results docs/results/policy_node.json
    python test/benchmarks/policy_node.py --real-time --seeds 20 --results docs/results/policy_node.json

The second drives the same starts in the environment and through the node, with real processes of node and simulator in
step; the third lets the simulator run in real time beside the node, which needs a machine with nothing else to do.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import rclpy
from _common import Row, executable
from control_latency import compare
from ctrl_rl_bringup.runner import NodeSpec, policy_nodes, simulator
from ctrl_rl_bringup.transfer import play_episode
from ctrl_rl_core.command import OptionalFileToWrite, make_command, some_of
from ctrl_rl_core.io import read_experiment
from geometry_msgs.msg import TwistStamped
from rclpy.client import Client
from rclpy.time import Time
from sensor_msgs.msg import LaserScan
from std_srvs.srv import SetBool

from ctrl_rl_bringup import DriveConfig
from ctrl_rl_core import (
    COMMAND,
    RESULT,
    SENSOR,
    Actor,
    Outcome,
    Result,
    find_policy,
    load_navigation_task,
    load_policy,
    write_results,
)
from ctrl_rl_msgs.msg import EpisodeStatus, RotorThrusts, TaskOutcome
from ctrl_rl_msgs.srv import ResetWorld, StepWorld
from sim_bridge import NavigationEnv, SimulationOptions

POLICY = "curved_corridor"
"""The policy whose latency is taken: the largest observation of those that ship."""
POLICIES = {
    **{name: name for name in ("car_ttr", "car_navigation", "quad_ttr", "quad_navigation", "curved_corridor")},
    "curved_corridor_edmd": "curved_corridor",
    "corridor_doorways": "corridor_doorways",
}
"""Tasks by shipped policy."""
DELAY = 0.005
"""Time from a scan to the effect of its command in the simulator [s]; measured are 2 ms on a busy machine."""
ARRIVAL_S = 0.015
"""Wall time from the arrival of a command here until it has surely arrived at the simulator, too [s]."""
REPEATS = 5
"""Runs of the latency, each with its own processes."""


@dataclass(frozen=True)
class Options:
    """Measure latency and success of the policy node, and write them as results."""

    results: OptionalFileToWrite = None
    """JSON file to write; rows of tasks that are not measured stay in it."""
    seeds: int = 100
    """Number of episodes of each policy."""
    policies: Annotated[tuple[str, ...], some_of(POLICIES)] = tuple(POLICIES)
    """Shipped policies."""
    real_time: bool = False
    """Let the simulator run in real time beside the node, and take no latency."""


def rows() -> list[Row]:
    """Return the latency of the node, with its ratio to the echo's."""
    out, _ = compare("policy node", "ctrl_rl_core", "policy", (f"policy:={POLICY}",))
    return out


def in_environment(policy: str, seeds: range) -> list[bool]:
    """Return which episodes reach the goal in the task's environment.

    A policy that decides at each scan has none of its own: it drives in one process, without ROS's transport.
    """
    task = POLICIES[policy]
    driver, world, settings = load_policy(find_policy(policy)), load_navigation_task(task), SimulationOptions()
    if driver.period is None:
        return [play_episode(driver, world, seed, settings).outcome == Outcome.GOAL.name for seed in seeds]
    actor, environment = Actor.load(find_policy(policy)), NavigationEnv(task)
    reached = []
    try:
        for seed in seeds:
            observation, info = environment.reset(seed=seed)
            over = False
            while not over:
                action = actor.scaled_action((observation - actor.middle) / actor.unit)
                observation, _, ended, cut, info = environment.step(action)
                over = ended or cut
            reached.append(info["outcome"] == Outcome.GOAL.name)
    finally:
        environment.close()
    return reached


def through_node(policy: str, seeds: range, real_time: bool) -> list[bool]:
    """Return which episodes reach the goal when the node drives.

    In step with the simulator the world stands while the node answers, so that a busy machine changes nothing; a
    command takes effect `DELAY` after its scan, as it would with a node that answers in so long.

    Args:
        policy: Name of a shipped policy.
        seeds: Seeds of the episodes.
        real_time: Whether the simulator runs in real time instead.
    """
    from ctrl_rl_bringup.runner import own_domain

    with own_domain("policy_node"):
        rclpy.init()
        try:
            with _Pair(policy, 0.0 if real_time else DELAY) as pair:
                return [pair.run(seed) if real_time else pair.step(seed) for seed in seeds]
        finally:
            rclpy.try_shutdown()


class _Pair:
    """A bridge and a policy node."""

    def __init__(self, policy: str, delay: float) -> None:
        task = load_navigation_task(POLICIES[policy])
        run = DriveConfig(Path("unused"), task=task.name, policy=policy, simulation={"command_delay": delay})
        specs = [simulator(run), replace(policy_nodes(run, task)[0], remappings={})]
        self._processes = [subprocess.Popen(_words(spec), stdout=subprocess.DEVNULL) for spec in specs]
        self._period = 1.0 / task.lidar.rate
        self._node = rclpy.create_node("stepper")
        kind, topic = (RotorThrusts, "rotor_thrusts") if task.plane == "xz" else (TwistStamped, "cmd_vel")
        self._answered = self._scanned = -1
        self._episode = EpisodeStatus()
        self._node.create_subscription(kind, topic, self._on_command, COMMAND)
        self._node.create_subscription(LaserScan, "scan", self._on_scan, SENSOR)
        self._node.create_subscription(EpisodeStatus, "episode", self._on_episode, RESULT)
        self._reset = self._node.create_client(ResetWorld, "sim_bridge/reset")
        self._step = self._node.create_client(StepWorld, "sim_bridge/step")
        self._pause = self._node.create_client(SetBool, "sim_bridge/pause")

    def __enter__(self) -> _Pair:
        self._wait(lambda: self._step.service_is_ready() and self._node.count_subscribers("scan") == 2, 120.0)
        self._wait(lambda: self._node.count_publishers("odom") == 1, 120.0)
        time.sleep(2.0)  # the last match is seen here before it is seen by both of its ends
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes:
            process.send_signal(signal.SIGINT)
            process.wait(30.0)
        self._node.destroy_node()

    def run(self, seed: int) -> bool:
        """Return whether the episode of a seed reaches the goal in real time."""
        self._begin(seed)
        self._call(self._pause, SetBool.Request(data=False))
        self._wait(lambda: self._episode.outcome.value != TaskOutcome.RUNNING, 600.0)
        self._call(self._pause, SetBool.Request(data=True))
        return bool(self._episode.outcome.value == TaskOutcome.GOAL)

    def _begin(self, seed: int) -> None:
        before = self._scanned
        number = self._call(self._reset, ResetWorld.Request(seed=seed)).episode
        self._wait(lambda: self._scanned > before and self._episode.episode == number)

    def step(self, seed: int) -> bool:
        """Return whether the episode of a seed reaches the goal in step."""
        self._begin(seed)
        while self._episode.outcome.value == TaskOutcome.RUNNING:
            self._wait(lambda: self._answered >= self._scanned)
            time.sleep(ARRIVAL_S)
            before = self._scanned
            self._call(self._step, StepWorld.Request(duration=self._period))
            self._wait(lambda before=before: self._scanned > before)
        return bool(self._episode.outcome.value == TaskOutcome.GOAL)

    def _on_command(self, message: TwistStamped | RotorThrusts) -> None:
        self._answered = Time.from_msg(message.header.stamp).nanoseconds

    def _on_scan(self, message: LaserScan) -> None:
        self._scanned = Time.from_msg(message.header.stamp).nanoseconds

    def _on_episode(self, message: EpisodeStatus) -> None:
        self._episode = message

    def _call(self, client: Client, request: Any) -> Any:
        future = client.call_async(request)
        self._wait(future.done)
        return future.result()

    def _wait(self, done: Callable[[], bool], longest: float = 30.0) -> None:
        deadline = time.monotonic() + longest
        while not done():
            rclpy.spin_once(self._node, timeout_sec=0.05)
            if time.monotonic() > deadline:
                raise RuntimeError("the nodes do not answer")


def _words(spec: NodeSpec) -> list[str]:
    given = [
        f"{name}:={str(value).lower() if isinstance(value, bool) else value}" for name, value in spec.parameters.items()
    ]
    parameters = [word for each in given for word in ("-p", each)]
    return [executable(spec.package, spec.executable), "--ros-args", "--log-level", "error", *parameters]


def _kept(options: Options, measured: set[tuple[str, str]]) -> list[Result]:
    """Return the rows that the file has already, but for methods and metrics that are measured anew."""
    if options.results is None or not options.results.exists():
        return []
    there = read_experiment(options.results)
    rows = [row for row in there.rows if (row.method, row.metric) not in measured]
    return [Result(row.method, row.metric, row.unit, row.values) for row in rows]


def measure(options: Options) -> int:
    """Measure, print, and write after each figure."""
    seeds = range(options.seeds)
    found = [] if options.real_time else _latency()
    _write(options, found)
    how = " in real time" if options.real_time else ""
    for policy in options.policies:
        own, driven = in_environment(policy, seeds), through_node(policy, seeds, options.real_time)
        difference = [float(there) - float(here) for there, here in zip(driven, own, strict=True)]
        if not options.real_time:
            found.append(Result(policy, "success in the environment", "1", [float(each) for each in own]))
        found += [
            Result(policy, f"success through the node{how}", "1", [float(each) for each in driven]),
            Result(policy, f"success difference{how}", "1", [float(np.mean(difference))]),
        ]
        _write(options, found)
        print(
            f"{policy:<20} {np.mean(own):7.1%} in the environment, {np.mean(driven):7.1%} through the node", flush=True
        )
    return 0


def _latency() -> list[Result]:
    ratios = []
    for _ in range(REPEATS):
        _, ratio = compare("policy node", "ctrl_rl_core", "policy", (f"policy:={POLICY}",), scans=500)
        ratios.append(ratio)
        print(f"latency over echo    {ratio:.3f}", flush=True)
    return [Result(POLICY, "latency over echo", "1", ratios)]


def _write(options: Options, found: list[Result]) -> None:
    if options.results is not None and found:
        rows = [*_kept(options, {(row.method, row.metric) for row in found}), *found]
        write_results(options.results, "policy_node", range(max(len(row.values) for row in rows)), rows)


if __name__ == "__main__":
    sys.exit(make_command("policy_node", Options, measure)())
