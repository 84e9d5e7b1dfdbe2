"""The command `replay`: an episode of a task with options, as words, as a timeline and as an animation."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.command import run_command
from ctrl_rl_core.tasks.task import task_digest

from option_coordinator.environments.option_env import OptionEnvironment
from option_coordinator.environments.roll_out import play_episodes
from option_coordinator.environments.tasks import load_option_task, make_environment
from option_coordinator.errors import OptionError
from option_coordinator.policies.policy_file import OptionPolicy
from option_coordinator.scripted.task_policies import DecisionPolicy, RandomPolicy, scripted_policy

_HOW = {"async": "whoever is ready chooses", "wait": "all wait for the last", "cut": "all are cut by the first"}


def replay(arguments: Sequence[str] | None = None) -> int:
    """Play an episode with a scripted, random or learnt policy, and draw it."""
    parser = argparse.ArgumentParser(
        prog="replay",
        description=replay.__doc__,
        epilog="example: replay tool_delivery --timeline timeline.png --animation replay.gif",
    )
    parser.add_argument("task", help="tool_delivery, water_filling, delivery_team, or a task or team file")
    parser.add_argument(
        "--policy", default="scripted", help="'scripted', 'random', or a file that `train` wrote (default %(default)s)"
    )
    parser.add_argument(
        "--choose",
        choices=("draws", "mode"),
        help="draws of a learnt policy, or its most likely options (default: its own)",
    )
    parser.add_argument(
        "--synchronisation",
        choices=tuple(_HOW),
        help=f"{'; '.join(f'{k}: {v}' for k, v in _HOW.items())} (default: a learnt policy's own, else async)",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the episode (default %(default)s)")
    parser.add_argument("--timeline", type=Path, help="PNG to draw who runs which option when")
    parser.add_argument("--animation", type=Path, help="GIF to draw the robots in the room; takes some seconds")
    options = parser.parse_args(arguments)
    return run_command("replay", lambda: _replay(options))


def _replay(options: argparse.Namespace) -> int:
    environment, choose = _prepare(options)
    (episode,) = play_episodes(environment, choose, range(options.seed, options.seed + 1))
    seconds = episode.steps * environment.simulation.time_step
    end = "done" if episode.terminated else "cut off"
    print(f"episode    {end} after {episode.steps} steps ({seconds:g} s), {episode.decisions} decisions")
    print(f"return     {episode.returned:g}")
    for name, figure in episode.figures.items():
        if name != "steps":
            print(f"{name:<10} {figure:g}")
    _draw(options, environment)
    return 0


def _draw(options: argparse.Namespace, environment: OptionEnvironment) -> None:
    if options.timeline is None and options.animation is None:
        return
    from option_coordinator.plots import draw_replay, draw_timeline  # matplotlib is not for robots

    title = f"{options.task}, {options.policy}"
    for file, draw in ((options.timeline, draw_timeline), (options.animation, draw_replay)):
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            draw(environment, title, file)
            print(f"picture    {file}")


def _prepare(options: argparse.Namespace) -> tuple[OptionEnvironment, DecisionPolicy]:
    """Return environment and policy."""
    film = options.animation is not None
    if options.policy in ("scripted", "random"):
        environment = make_environment(options.task, options.synchronisation or "async", film=film)
        chooser = RandomPolicy(options.seed) if options.policy == "random" else scripted_policy(environment)
        return environment, chooser
    policy = OptionPolicy.load(options.policy)
    learnt = policy.manifest
    if learnt.get("task_digest") != task_digest(load_option_task(options.task)):
        raise OptionError(f"{options.policy}: was learnt for another task '{learnt.get('task')}', not '{options.task}'")
    world = ("synchronisation", "level", "sight", "drop")
    how: dict[str, Any] = {name: learnt[name] for name in world if name in learnt}
    if options.synchronisation is not None:
        how["synchronisation"] = options.synchronisation
    if options.choose is not None:
        policy = replace(policy, greedy=options.choose == "mode")
    generator = np.random.default_rng((options.seed, 1))  # not the world's own
    return make_environment(options.task, film=film, **how), lambda decision: policy.choose(decision, generator)
