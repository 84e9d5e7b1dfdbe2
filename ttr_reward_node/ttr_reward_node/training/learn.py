"""A policy learnt in a simulated task, in one call: `train` of the front door.

`ros2 run ttr_reward_node train` does the same for many seeds and rewards, and goes on where it was cut off.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from ctrl_rl_learning.sb3 import (
    ROLL_OUT,
    SUCCESS,
    Environment,
    FleetEnvironments,
    Recorder,
    entropy_of,
    evaluate,
    evaluate_in_fleet,
    extract_actor,
    fits_fleet,
    listen,
    make_algorithm,
    make_environment,
    number_of_environments,
    observation_names,
)
from ctrl_rl_learning.study import Curves

from ctrl_rl_core import Actor, Episodes, NavigationTask, interface_of, load_navigation_task, task_digest
from ttr_reward_node.rewards.progress import TimeToReach
from ttr_reward_node.solving import solve_value
from ttr_reward_node.training.time_to_reach_reward import TimeToReachReward

_TEST_SEED = 1_000_000


def train(
    task: NavigationTask | str | Path,
    algorithm: str = "ppo",
    *,
    reward: TimeToReach | None = None,
    samples: int = 100_000,
    seed: int = 0,
    episodes: int = 50,
    tell: Callable[[int], object] | None = None,
    curves: str | Path | None = None,
) -> Actor:
    """Learn a policy in a simulated task; robots drive side by side where the task is a fleet's.

    The policy's `save` writes a file for the node `policy`, with the success in fresh episodes in its manifest.

    >>> import ctrl_rl
    >>> value = ctrl_rl.solve("car_ttr", counts=(41, 41, 24))
    >>> policy = ctrl_rl.train("car_ttr", "ppo", reward=ctrl_rl.TimeToReach(value), samples=2048, episodes=2)
    >>> policy.manifest["metrics"]["episodes"]
    2

    Args:
        task: Navigation task in an arena, its name or its file.
        algorithm: "ppo", "trpo", "ddpg" or "sac".
        reward: Pay for the time to reach beside the task's own rewards; best progress of the time to reach that is
            solved here, unless given.
        samples: Number of samples; whole roll-outs of 2048 are done.
        seed: Seed of everything random.
        episodes: Number of fresh episodes in which the policy is tried.
        tell: Function that is told the number of samples after each roll-out.
        curves: Folder for the curves of loss, return, entropy and success, as CSV and for TensorBoard.

    Raises:
        CtrlRlError: There is no such task or algorithm, or the reward does not fit the task.
    """
    if not isinstance(task, NavigationTask):
        task = load_navigation_task(task)
    number = number_of_environments(algorithm)  # refuses an unknown one before anything is solved
    pay = TimeToReach(solve_value(task)) if reward is None else reward
    own_states = task.system.build().state_names
    pay.check_states(own_states)
    in_fleet = fits_fleet(task)
    make = partial(_environment, task, pay)
    torch.set_num_threads(1)
    model = make_algorithm(
        algorithm, FleetEnvironments(task, number, pay.for_robots(number)) if in_fleet else make, seed, samples
    )
    logger = listen(model)
    with ExitStack() as opened:
        if model.env is not None:
            opened.callback(model.env.close)
        drawn = None if curves is None else opened.enter_context(Curves(Path(curves)))
        for done in range(0, samples, ROLL_OUT):
            recorder = Recorder()
            model.learn(ROLL_OUT, recorder, reset_num_timesteps=done == 0)
            if drawn is not None:
                drawn.add(
                    {"samples": done + ROLL_OUT, **_figures(recorder), "losses": logger.take() | entropy_of(model)}
                )
            if tell is not None:
                tell(done + ROLL_OUT)
    manifest = {
        "task": task.name,
        "task_digest": task_digest(task),
        "algorithm": algorithm,
        "reward": pay.kind,
        "seed": seed,
        "samples": int(model.num_timesteps),
        "observation": observation_names(task),
        "commands": list(task.robot.commands),
    }
    actor = extract_actor(model, task, manifest)
    tried = _try(actor, task, episodes, make, in_fleet)
    success = sum(episode.outcome == SUCCESS for episode in tried) / max(episodes, 1)
    metrics = {"success": success, "episodes": episodes}
    return replace(actor, manifest={**manifest, "metrics": metrics}, interface=interface_of(task))


def _figures(recorder: Recorder) -> dict[str, float]:
    """Return success and return of the episodes that ended; nothing where none did."""
    count = len(recorder.outcomes)
    if not count:
        return {}
    return {"success": recorder.outcomes.count(SUCCESS) / count, "return": sum(recorder.returns) / count}


def _environment(task: NavigationTask, pay: TimeToReach) -> Environment:
    def wrap(environment: Environment) -> Environment:
        return TimeToReachReward(
            environment, pay.value, kind=pay.kind, per_second=pay.per_second, discount=pay.discount
        )

    return make_environment(task, None, wrap)


def _try(
    actor: Actor, task: NavigationTask, episodes: int, make: Callable[[], Environment], in_fleet: bool
) -> Episodes[Any]:
    """Return fresh episodes of a policy."""
    if in_fleet or not episodes:
        return evaluate_in_fleet(actor, task, range(_TEST_SEED, _TEST_SEED + episodes))
    environment = make()
    try:
        return evaluate(actor, environment, episodes, _TEST_SEED)
    finally:
        environment.close()
