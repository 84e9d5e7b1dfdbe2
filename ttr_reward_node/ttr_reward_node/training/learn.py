"""Training of a policy on a simulated task in one call: the function `ctrl_rl.train`.

`ros2 run ttr_reward_node train` does the same for several seeds and rewards, and resumes interrupted runs.
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
    """Train a policy on a simulated task, in a fleet of robots if the task supports it.

    The policy's method `save` writes a file for the node `policy`; its manifest holds the success rate in new episodes.

    >>> import ctrl_rl
    >>> value = ctrl_rl.solve("car_ttr", counts=(41, 41, 24))
    >>> policy = ctrl_rl.train("car_ttr", "ppo", reward=ctrl_rl.TimeToReach(value), samples=2048, episodes=2)
    >>> policy.manifest["metrics"]["episodes"]
    2

    Args:
        task: Navigation task in an arena, its name or its file.
        algorithm: "ppo", "trpo", "ddpg" or "sac".
        reward: Progress reward added to the task's own rewards; by default the time to reach is solved here and its
            best progress is paid.
        samples: Number of samples, rounded up to whole roll-outs of 2048.
        seed: Random seed.
        episodes: Number of new episodes in which the policy is evaluated.
        tell: Function called with the number of samples after each roll-out.
        curves: Folder for the curves of loss, return, entropy and success, as CSV and for TensorBoard.

    Raises:
        CtrlRlError: There is no such task or algorithm, or the reward does not fit the task.
    """
    if not isinstance(task, NavigationTask):
        task = load_navigation_task(task)
    number = number_of_environments(algorithm)  # rejects an unknown algorithm before anything is solved
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
    """Return success and return of the finished episodes; empty if there are none."""
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
    """Evaluate a policy in new episodes and return them."""
    if in_fleet or not episodes:
        return evaluate_in_fleet(actor, task, range(_TEST_SEED, _TEST_SEED + episodes))
    environment = make()
    try:
        return evaluate(actor, environment, episodes, _TEST_SEED)
    finally:
        environment.close()
