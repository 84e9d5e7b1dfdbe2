"""Learns a policy from transitions: better commands by a value function, scales, batches, updates; all in one call.

actor = learn(transitions, task, LearningSettings("iql"))
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ctrl_rl_core import Actor, NavigationTask, ValueFunction, task_digest
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.data.digests import episode_digests
from ctrl_rl_learning.offline.data.motion import MotionModel, fit_motion
from ctrl_rl_learning.offline.data.transitions import RecordedDrives, Transitions, sensed_interface
from ctrl_rl_learning.offline.data.values import TIME_TO_REACH, StateValues, clearance_of, load_values
from ctrl_rl_learning.offline.learners.learners import LEARNERS, Batch
from ctrl_rl_learning.offline.learners.settings import METHODS, NEEDS_REWARD, NEEDS_VALUE, LearningSettings
from ctrl_rl_learning.study.curves import Curves
from ctrl_rl_learning.torch.networks import new_actor

Vectors = NDArray[np.float32]
_LEAST_UNIT = 1e-3


def scales_of(observations: Vectors) -> tuple[Vectors, Vectors]:
    """Return middle and unit (n,), (n,) of observations (N, n): mean and spread, so that inputs are of order 1."""
    spread = observations.std(axis=0)
    return observations.mean(axis=0), np.where(spread > _LEAST_UNIT, spread, 1.0).astype(np.float32)


def batches(
    tensors: tuple[Tensor, ...], size: int, count: int, random: np.random.Generator
) -> Iterator[tuple[Tensor, ...]]:
    """Yield `count` random batches of rows."""
    rows = len(tensors[0])
    for _ in range(count):
        chosen = torch.from_numpy(random.integers(rows, size=size))
        yield tuple(tensor[chosen] for tensor in tensors)


Array = NDArray[np.float64]
_CANDIDATES = 9  # of each of the two commands
_AT_ONCE = 512


def improved_actions(
    states: Array, model: MotionModel, values: StateValues, temperature: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Return better actions (N, 2), and where they are known (N,): not where every action ends too near to an obstacle.

    An action is the mean of a grid of actions, weighted by exp(Q / temperature).
    Q is reward and value of where the model says that a step ends, in units of the usual difference between the best
    action of a state and the middle one. A soft maximum changes gradually from state to state, as a network can.

    Args:
        states: States x, y, theta (N, 3).
        model: Model of the robot's motion in a step.
        values: Value function that the actions are judged by.
        temperature: Difference of Q that multiplies a weight by e.

    Raises:
        LearningError: They are known nowhere.
    """
    side = np.linspace(-1.0, 1.0, _CANDIDATES)
    actions = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    worth = np.concatenate(
        [_worth(states[first : first + _AT_ONCE], actions, model, values) for first in range(0, len(states), _AT_ONCE)]
    )
    best = worth.max(axis=1, keepdims=True)
    known = best[:, 0] > worth.min()
    if not known.any():
        raise LearningError("the value function knows no way to the goal from where the bags drove: is it this task's?")
    unit = max(float(np.median(best[known] - np.median(worth[known], axis=1, keepdims=True))), 1e-9)
    weights = np.exp((worth - best) / (temperature * unit))
    return weights @ actions / weights.sum(axis=1, keepdims=True), known


def _worth(states: Array, actions: Array, model: MotionModel, values: StateValues) -> Array:
    """Return Q (N, K) of each of K actions at each of N states."""
    from_each = np.repeat(states, len(actions), axis=0)
    each = np.tile(actions, (len(states), 1))
    worth = values.after_step(model(from_each, each, 0.5), model(from_each, each))
    return worth.reshape(len(states), len(actions))


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
        "learnt_from": {
            "transitions": len(transitions),
            "episodes": transitions.episode_count,
            "digests": episode_digests(transitions),
        },
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
                f"the bags have no rewards, which {method} learns from: relabel them first, by `ros2 run "
                "ttr_reward_node relabel --grid FILE` with a file of `ros2 run ttr_reward_node solve`"
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


def learn_from_drives(
    data: RecordedDrives,
    method: str = "value_model",
    *,
    value: ValueFunction | None = None,
    updates: int = 5000,
    seed: int = 0,
) -> Actor:
    """Learn a policy from recorded drives alone; its `save` writes a file for the node `policy`.

    >>> import ctrl_rl, tempfile, pathlib
    >>> from ctrl_rl_learning.offline import ScriptedDriver, drive      # records without ROS
    >>> task = ctrl_rl.load_task("car_navigation")
    >>> bag = pathlib.Path(tempfile.mkdtemp()) / "bag"
    >>> _ = drive(task, ScriptedDriver(task), episodes=3, seed=0, bag=bag)
    >>> policy = ctrl_rl.learn_offline(ctrl_rl.transitions([bag], task), "bc", updates=20)
    >>> policy.manifest["method"]
    'bc'

    Args:
        data: Drives that `ctrl_rl.transitions` has read.
        method: One of `ctrl_rl_learning.offline.learners.settings.METHODS`: value_model (the default), value_weight and
            value_critic learn from a value function; td3bc, iql and cql from rewards in the bags; bc clones.
        value: Value function of the task, for the methods that need one; its time to reach by what the robot can do,
            with room of half its radius to obstacles, is solved here unless given.
        updates: Number of updates of the networks.
        seed: Seed of weights and batches.

    Raises:
        LearningError: There is no such method, the bags do not hold what it needs, or they show other walls than the
            task's, which all methods but bc believe.
        CtrlRlError: The value function does not fit the task.
    """
    if method not in METHODS:
        raise LearningError(f"no method '{method}': there are {', '.join(METHODS)}")
    if data.refusal and method != "bc":
        raise LearningError(data.refusal)
    values = None if value is None else StateValues(value, data.task)
    if values is None and method in NEEDS_VALUE:
        with TemporaryDirectory() as folder:
            values = load_values(TIME_TO_REACH, data.task, Path(folder), clearance_of(data.task, None))
    settings = LearningSettings(method, updates, seed=seed)
    return learn(data.transitions, data.task, settings, values, {"bags": list(data.bags)})
