"""Runs: one drive under the controller, many drives from random starts, and training drives."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ctrl_rl_core.io import kind_of, with_digest

from ctrl_rl_bringup.corridor.report import DriveReport, read_drive
from ctrl_rl_bringup.runner.monitor import EpisodeProgress, Monitor
from ctrl_rl_bringup.runner.prepare import new_run, value_files
from ctrl_rl_bringup.runner.processes import Processes, ros
from ctrl_rl_bringup.runner.stack import (
    DriveConfig,
    NodeSpec,
    controller,
    guards,
    policy_nodes,
    recorder,
    scripted_driver,
    simulator,
    value_nodes,
    watchdog,
)
from ctrl_rl_core import CtrlRlError, atomic_write, find_policy, load_navigation_task, load_policy, task_file
from ctrl_rl_msgs.msg import TaskOutcome


@dataclass(frozen=True)
class Artifacts:
    """Files that a drive writes besides its bag."""

    report: Path
    picture: Path


def drive(options: DriveConfig) -> DriveReport:
    """Drive once under the controller, with its reward; record everything and return the report."""
    policy = find_policy(options.policy)
    drivers = _drivers(options, policy)
    new_run(options)
    values = value_files(options)
    nodes = [*drivers, *value_nodes(options, values)]
    with running(options, nodes, {"policy": policy, **values}) as monitor:
        monitor.run()
        monitor.follow("driving")
    return read_drive(options.bag)


def write_artifacts(result: DriveReport, folder: Path) -> Artifacts:
    """Write report and picture of a drive into a folder."""
    out = Artifacts(folder / "report.json", folder / "path.png")
    atomic_write(out.report, json.dumps(with_digest(result.as_dict()), indent=2) + "\n")
    from ctrl_rl_bringup.corridor.plot import draw_drive  # matplotlib takes long to load

    draw_drive(result, out.picture)
    return out


def follow_running(topics: Sequence[str], ready_limit: float) -> int:
    """Follow a drive whose nodes run already; return 0 if it reaches the goal, else 1.

    Args:
        topics: Further topics that the drive waits for.
        ready_limit: Time within which all nodes must be ready [s].
    """
    with ros():
        monitor = Monitor(lambda: None, topics, ready_limit)
        with monitor.session():
            monitor.run()
            outcome = monitor.follow("driving").outcome
    return 0 if outcome == TaskOutcome.GOAL else 1


def drive_seeds(options: DriveConfig, seeds: Sequence[int]) -> list[EpisodeProgress]:
    """Drive under the controller once per seed, in one recorded session; return how each drive ended."""
    policy = find_policy(options.policy)
    drivers = _drivers(options, policy)
    new_run(options)
    with running(options, drivers, {"policy": policy}) as monitor:
        return _episodes(monitor, seeds, "seed")


def record_scripted(options: DriveConfig, seeds: Sequence[int]) -> list[EpisodeProgress]:
    """Record one drive of the scripted driver per seed, as training data."""
    new_run(options)
    with running(options, [scripted_driver(options.seed), watchdog(options.speed)], {}) as monitor:
        return _episodes(monitor, seeds, "drive")


def _drivers(options: DriveConfig, policy: Path) -> list[NodeSpec]:
    """Return the nodes that drive a policy: the controller for a Koopman policy, the policy node for any other.

    Raises:
        CtrlRlError: The policy is not for the robot of the task.
    """
    robot = load_policy(policy).robot
    task = load_navigation_task(options.task)
    if (robot == "planar_quadrotor") != (task.plane == "xz"):
        raise CtrlRlError(f"{policy.name} is for a {robot}, the robot of task '{task.name}' is a {task.robot.body}")
    if policy.suffix == ".safetensors" and "policy" in kind_of(policy):
        return [controller(options), *guards(options, task)]
    return policy_nodes(options, task)


def _episodes(monitor: Monitor, seeds: Sequence[int], title: str) -> list[EpisodeProgress]:
    out = []
    for index, seed in enumerate(seeds):
        monitor.reset(seed)
        if index == 0:
            monitor.run()
        out.append(monitor.follow(f"{title} {seed} ({index + 1} of {len(seeds)})", lines=1))
    return out


@contextmanager
def running(options: DriveConfig, nodes: Sequence[NodeSpec], digests: dict[str, Path]) -> Iterator[Monitor]:
    """Start simulator, recorder and nodes; end them in an order in which the recorder misses nothing."""
    with ros(), Processes(options.folder) as processes:
        processes.start([recorder(options, {"task": task_file(options.task), **digests}), simulator(options), *nodes])
        topics = [topic for node in nodes for topic in node.publishes]
        monitor = Monitor(processes.check, topics, options.ready_limit)
        with monitor.session():
            yield monitor
        for name in (*(node.executable for node in nodes), "bridge", "recorder"):
            processes.stop(name)
