"""The `replay` command: shows an episode of a task with options as text, timeline and animation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from ctrl_rl_core import parse_options, run_command, task_digest
from option_coordinator.environments.option_env import OptionEnvironment
from option_coordinator.environments.roll_out import play_episodes
from option_coordinator.environments.tasks import load_option_task, make_environment
from option_coordinator.errors import OptionError
from option_coordinator.policies.policy_file import OptionPolicy
from option_coordinator.scripted.task_policies import DecisionPolicy, RandomPolicy, scripted_policy

_EXAMPLE = "example: replay tool_delivery --timeline timeline.png --animation replay.gif"


@dataclass(frozen=True)
class ReplayOptions:
    """Play an episode with a scripted, random or learned policy, and draw it."""

    task: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TASK")]
    """Task tool_delivery or water_filling, team delivery_team, or a task or team file."""

    policy: str = "scripted"
    """Policy 'scripted' or 'random', or a file written by `train`."""

    choose: Literal["draws", "mode"] | None = None
    """Use of a learned policy: sampled or most likely options; by default as in training."""

    synchronisation: Literal["async", "wait", "cut"] | None = None
    """Which robots choose together. async: each when it is ready; wait: all, once the last is ready; cut: all, once the
    first is ready; by default a learned policy's own, else async."""

    seed: int = 0
    """Seed of the episode."""

    timeline: Path | None = None
    """PNG file for a timeline of the options run by each robot."""

    animation: Path | None = None
    """GIF file for an animation of the robots; takes some seconds."""


def replay(arguments: Sequence[str] | None = None) -> int:
    """Play an episode with a scripted, random or learned policy, and draw it."""
    options = parse_options("replay", ReplayOptions, arguments, _EXAMPLE)
    return run_command("replay", lambda: _replay(options))


def _replay(options: ReplayOptions) -> int:
    environment, choose = prepare_replay(options)
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


def _draw(options: ReplayOptions, environment: OptionEnvironment) -> None:
    if options.timeline is None and options.animation is None:
        return
    from option_coordinator.plots import draw_replay, draw_timeline  # matplotlib is not installed on robots

    title = f"{options.task}, {options.policy}"
    for file, draw in ((options.timeline, draw_timeline), (options.animation, draw_replay)):
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            draw(environment, title, file)
            print(f"picture    {file}")


def prepare_replay(options: ReplayOptions) -> tuple[OptionEnvironment, DecisionPolicy]:
    """Create the environment and the policy of a replay."""
    film = options.animation is not None
    if options.policy in ("scripted", "random"):
        environment = make_environment(options.task, options.synchronisation or "async", film=film)
        chooser = RandomPolicy(options.seed) if options.policy == "random" else scripted_policy(environment)
        return environment, chooser
    policy = OptionPolicy.load(options.policy)
    learned = policy.manifest
    if learned.get("task_digest") != task_digest(load_option_task(options.task)):
        raise OptionError(f"{options.policy}: was learned for task '{learned.get('task')}', not '{options.task}'")
    world = ("synchronisation", "level", "sight", "drop")
    settings: dict[str, Any] = {name: learned[name] for name in world if name in learned}
    if options.synchronisation is not None:
        settings["synchronisation"] = options.synchronisation
    if options.choose is not None:
        policy = replace(policy, greedy=options.choose == "mode")
    generator = np.random.default_rng((options.seed, 1))  # the world has its own otherwise
    return make_environment(options.task, film=film, **settings), lambda decision: policy.choose(decision, generator)
