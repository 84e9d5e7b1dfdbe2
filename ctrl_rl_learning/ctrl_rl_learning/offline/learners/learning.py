"""Learns a policy from transitions: scales, batches, updates, and the actor that comes out.

actor = learn(transitions, task, LearningSettings("iql"))
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ctrl_rl_core import Actor, NavigationTask, task_digest
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.data.interface import sensed_interface
from ctrl_rl_learning.offline.data.motion import fit_motion
from ctrl_rl_learning.offline.data.transitions import Transitions
from ctrl_rl_learning.offline.data.values import StateValues
from ctrl_rl_learning.offline.learners.batches import batches, scales_of
from ctrl_rl_learning.offline.learners.improvement import improved_actions
from ctrl_rl_learning.offline.learners.learners import LEARNERS, Batch
from ctrl_rl_learning.offline.learners.settings import METHODS, NEEDS_REWARD, NEEDS_VALUE, LearningSettings
from ctrl_rl_learning.study.curves import Curves
from ctrl_rl_learning.torch.networks import new_actor

_POINTS = 100
"""Points of the curves."""


def learn(
    transitions: Transitions,
    task: NavigationTask,
    settings: LearningSettings,
    values: StateValues | None = None,
    about: Mapping[str, Any] | None = None,
    tell: Callable[[int], object] = lambda _: None,
    curves: Curves | None = None,
) -> Actor:
    """Return a policy learnt from transitions alone.

    Args:
        transitions: Transitions of the driver.
        task: Task that the policy is for.
        settings: Method and its numbers.
        values: Value function that weighs or criticises; only some methods need one.
        about: More for the policy's manifest, as JSON.
        tell: Told the number of updates since the last call.
        curves: Curves that the mean losses of each hundredth of the updates are added to.

    Raises:
        LearningError: There is no such method, it lacks a value function, or the bags have no rewards.
    """
    if settings.method not in METHODS:
        raise LearningError(f"no method '{settings.method}': there are {', '.join(METHODS)}")
    if settings.method in NEEDS_VALUE and values is None:
        raise LearningError(f"{settings.method} needs a value function: give --value")
    interface = sensed_interface(task)
    middle, unit = scales_of(transitions.observations)
    batch_of = _tensors(transitions, task, settings, values, middle, unit)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        learner = LEARNERS[settings.method](new_actor(interface, settings.hidden, middle, unit), settings)
        random = np.random.default_rng(settings.seed)
        losses: dict[str, list[torch.Tensor]] = {}
        for count, batch in enumerate(batches(batch_of, settings.batch, settings.updates, random), 1):
            learner.anneal((count - 1) / settings.updates)
            for name, loss in learner.update(Batch(*batch)).items():
                losses.setdefault(name, []).append(loss)
            tell(1)
            if curves is not None and (count % max(1, settings.updates // _POINTS) == 0 or count == settings.updates):
                means = {name: float(torch.stack(each).mean()) for name, each in losses.items()}
                curves.add({"updates": count, "loss": next(iter(means.values())), **means})
                losses = {}
    manifest = {
        "task": task.name,
        "task_digest": task_digest(task),
        "method": settings.method,
        "learnt_from": {"transitions": len(transitions), "episodes": transitions.episode_count},
        "settings": vars(settings),
        **({} if values is None else {"value": values.name}),
        **(about or {}),
    }
    return learner.actor.to_actor(manifest)


def _tensors(
    transitions: Transitions,
    task: NavigationTask,
    settings: LearningSettings,
    values: StateValues | None,
    middle: NDArray[np.float32],
    unit: NDArray[np.float32],
) -> Batch:
    """Return all transitions as tensors, in the networks' units."""
    method = settings.method
    paid = np.zeros(len(transitions))
    if method in NEEDS_REWARD:
        paid = transitions.rewards
        if not np.isfinite(paid[transitions.outcomes == 0]).any():
            raise LearningError(
                f"the bags have no rewards, which {method} learns from: relabel them first, "
                "`ros2 run ttr_reward_node relabel`"
            )
        # States that a reward is unknown of, outside of its value's domain, pay the least that any known one does.
        paid = np.where(np.isfinite(paid), paid, np.nanmin(paid)) / _scale(transitions)
    advantage = np.zeros(len(transitions))
    if values is not None and method == "value_weight":
        advantage = _standardised(values.advantages(transitions))
        advantage -= np.quantile(advantage, 0.9)
    elif values is not None and method == "value_critic":
        advantage = _standardised(values.advantages(transitions))
    actions: NDArray[Any] = transitions.actions
    if values is not None and method == "value_model":
        motion = fit_motion(transitions)
        actions, known = improved_actions(transitions.states, motion, values, settings.weight_temperature)
        if task.corridor is not None:
            # Without its pose a robot cannot tell that it faces back: from there it is taught nothing.
            known &= motion.moved(actions)[:, 0] > 0.0
        advantage = np.where(known, 0.0, -np.inf)
    arrays = (
        (transitions.observations - middle) / unit,
        actions,
        paid,
        (transitions.next_observations - middle) / unit,
        transitions.done,
        advantage,
    )
    return Batch(*(torch.from_numpy(np.asarray(array, dtype=np.float32)) for array in arrays))


def _scale(transitions: Transitions) -> float:
    """Return the largest reward or penalty of an episode's end, or else of a step."""
    ends = np.abs(transitions.task_rewards).max(initial=0.0)
    return float(ends or np.nanmax(np.abs(transitions.rewards), initial=0.0) or 1.0) / 10.0


def _standardised(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return numbers around 0 in units of their middle spread, rare large ones cut off: collisions are far below."""
    low, middle, high = np.quantile(numbers, (0.1, 0.5, 0.9))
    return np.clip((numbers - middle) / max(0.39 * (high - low), 1e-6), -10.0, 10.0)
