"""The policy node: latency against a bare echo, and the success of shipped policies against that in their environment.

    python test/benchmarks --only policy_node                                 # the latency
    python test/benchmarks/policy_node.py --results docs/results/policy_node.json

The second drives the same starts in the environment and through the node, in the simulator with real processes.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from _common import Row
from control_latency import compare
from ctrl_rl_core.command import OptionalFileToWrite, make_command

from ctrl_rl_core import Actor, Outcome, Result, find_policy, load_navigation_task, write_results

POLICY = "curved_corridor"
"""The policy whose latency is taken: the largest observation of those that ship."""
TASKS = ("car_ttr", "car_navigation", "quad_ttr", "quad_navigation")
REPEATS = 5
"""Runs of the latency, each with its own processes."""


@dataclass(frozen=True)
class Options:
    """Measure latency and success of the policy node, and write them as results."""

    results: OptionalFileToWrite = None
    """JSON file to write."""
    seeds: int = 100
    """Number of episodes of each policy."""
    speed: float = 3.0
    """Simulation time per wall time."""
    tasks: tuple[str, ...] = TASKS
    """Tasks, whose shipped policies drive."""


def rows() -> list[Row]:
    """Return the latency of the node, with its ratio to the echo's."""
    out, _ = compare("policy node", "ctrl_rl_core", "policy", (f"policy:={POLICY}",))
    return out


def in_environment(task: str, seeds: range) -> list[bool]:
    """Return which episodes reach the goal in the task's environment."""
    from sim_bridge.environments import NavigationEnv

    actor, environment = Actor.load(find_policy(task)), NavigationEnv(task)
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


def through_node(task: str, seeds: range, speed: float) -> list[bool]:
    """Return which episodes reach the goal when the node drives."""
    from ctrl_rl_bringup.corridor.drive import drive_seeds
    from ctrl_rl_bringup.runner.domain import own_domain
    from ctrl_rl_bringup.runner.stack import DriveConfig

    from ctrl_rl_msgs.msg import TaskOutcome

    with TemporaryDirectory() as folder, own_domain("policy_node"):
        run = DriveConfig(Path(folder) / "run", task=task, policy=task, speed=speed)
        return [episode.outcome == TaskOutcome.GOAL for episode in drive_seeds(run, seeds)]


def measure(options: Options) -> int:
    """Measure, print and write."""
    found, seeds = [], range(options.seeds)
    for task in options.tasks:
        load_navigation_task(task)
        own, driven = in_environment(task, seeds), through_node(task, seeds, options.speed)
        difference = [float(there) - float(here) for there, here in zip(driven, own, strict=True)]
        found += [
            Result(task, "success in the environment", "1", [float(each) for each in own]),
            Result(task, "success through the node", "1", [float(each) for each in driven]),
            Result(task, "success difference", "1", [float(np.mean(difference))]),
        ]
        print(f"{task:<20} {np.mean(own):7.1%} in the environment, {np.mean(driven):7.1%} through the node", flush=True)
    ratios = []
    for _ in range(REPEATS):
        _, ratio = compare("policy node", "ctrl_rl_core", "policy", (f"policy:={POLICY}",), scans=500)
        ratios.append(ratio)
        print(f"latency over echo    {ratio:.3f}", flush=True)
    found.append(Result(POLICY, "latency over echo", "1", ratios))
    if options.results is not None:
        write_results(options.results, "policy_node", list(seeds), found)
    return 0


if __name__ == "__main__":
    sys.exit(make_command("policy_node", Options, measure)())
