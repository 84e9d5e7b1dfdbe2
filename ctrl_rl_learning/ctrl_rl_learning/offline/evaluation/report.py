"""What a policy would earn, with intervals, beside what the bags show; and the verdict on it.

report = evaluate_offline(transitions, task, actor, values)
report.verdict     # "better" where every assumption of the estimate holds on the bags
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Actor, NavigationTask, Outcome, terminal_reward
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.data.digests import fitted_to
from ctrl_rl_learning.offline.data.transitions import Transitions
from ctrl_rl_learning.offline.data.values import StateValues
from ctrl_rl_learning.offline.evaluation.estimators import (
    PolicyValues,
    actions_of,
    episode_estimates,
    fit_values,
    step_ratios,
)
from ctrl_rl_learning.offline.evaluation.recorded import look_at
from ctrl_rl_learning.offline.evaluation.replay import replay
from ctrl_rl_learning.offline.evaluation.roll_outs import can_model, roll_out
from ctrl_rl_learning.offline.evaluation.support import (
    ModelSupport,
    commands_beyond,
    coverage,
    model_support,
    spread_of,
)
from ctrl_rl_learning.offline.evaluation.verdict import LEAST_EPISODES, OfflineReport, believed
from ctrl_rl_learning.offline.learners.learning import learn
from ctrl_rl_learning.offline.learners.settings import LearningSettings
from ctrl_rl_learning.study.results import Estimate, estimate

Array = NDArray[np.float64]
_LEAST_STEPS = 100
"""Recorded steps that a model of motion needs."""


def evaluate_offline(
    transitions: Transitions,
    task: NavigationTask,
    actor: Actor,
    values: StateValues | None = None,
    *,
    discount: float = 0.99,
    updates: int = 3000,
    fits: int = 3,
    seed: int = 0,
    tell: Callable[[int], object] = lambda _: None,
) -> OfflineReport:
    """Return what bags say about a policy that has not driven.

    Args:
        transitions: Transitions of other drivers.
        task: Task of both.
        actor: Policy with the task's observation.
        values: Time to reach of the task, for the value function's own prediction.
        discount: Discount of a step.
        updates: Number of updates of each fit.
        fits: Number of fits, whose spread is part of the intervals.
        seed: Seed of fits and resampling.
        tell: Told the number of updates since the last call.

    Raises:
        LearningError: The policy observes something else.
    """
    if len(actor.middle) != transitions.observations.shape[1]:
        raise LearningError(
            f"the policy observes {len(actor.middle)} numbers, the task's policies "
            f"{transitions.observations.shape[1]}: it is another task's"
        )
    random = np.random.default_rng(seed)
    starts = np.flatnonzero(transitions.first)
    earned, seen = transitions.returns(discount), fitted_to(actor.manifest, transitions)
    modelled = _modelled(transitions, task, actor, earned, discount, fits, seed)
    clone = learn(transitions, task, LearningSettings("bc", updates=max(200, updates // 5), seed=seed))
    own, cloned = (actions_of(each, transitions.observations) for each in (actor, clone))
    spread = spread_of(transitions, cloned)
    cloned_after = actions_of(clone, transitions.next_observations)
    known = coverage(actions_of(actor, transitions.next_observations), cloned_after, spread)

    def fit(paid: Transitions, by: float, bounds: tuple[float, float], number: int) -> PolicyValues:
        return fit_values(paid, actor, by, updates, seed + number, bounds, known, tell)

    fitted = [fit(transitions, discount, _bounds(task), number) for number in range(fits)]
    reached = None
    if not believed(modelled.support):
        goals = replace(transitions, task_rewards=(transitions.outcomes == Outcome.GOAL).astype(np.float64))
        reached = estimate(np.array([fit(goals, 1.0, (0.0, 1.0), k).before[starts] for k in range(fits)]), random)
    first = np.array([each.before[starts] for each in fitted])
    robust, effective = _robust(transitions, fitted, step_ratios(transitions, cloned, own), discount)
    times = _times(transitions, task, own, values)
    return OfflineReport(
        episodes=len(starts),
        held_out=None if seen is None else int((~seen).sum()),
        driver=estimate(earned[None], random),
        driver_success=transitions.success,
        fitted_q=estimate(first, random),
        fitted_success=reached,
        doubly_robust=estimate(robust, random),
        effective_episodes=effective,
        coverage=float(coverage(own, cloned, spread).mean()),
        gain=estimate(first - earned, random),
        robust_gain=estimate(robust - earned, random),
        model=modelled.returns,
        model_gain=modelled.gain,
        model_success=modelled.success,
        support=modelled.support,
        commands=commands_beyond(transitions, task, own),
        time_lost=None if times is None else estimate(times[0][None], random),
        driver_time_lost=None if times is None else estimate(times[1][None], random),
        predicted_time=None if times is None or not len(times[2]) else estimate(times[2][None], random),
        recorded_time=None if times is None or not len(times[3]) else estimate(times[3][None], random),
    )


class _Modelled(NamedTuple):
    """What roll-outs say, and what they rest on; None each where there can be none."""

    returns: Estimate | None = None
    gain: Estimate | None = None
    success: Estimate | None = None
    support: ModelSupport | None = None


def _modelled(
    transitions: Transitions, task: NavigationTask, actor: Actor, earned: Array, discount: float, fits: int, seed: int
) -> _Modelled:
    """Roll a policy out in models; intervals hold what each kind of model says."""
    steps = int((transitions.outcomes == Outcome.RUNNING).sum())
    if not can_model(task) or len(earned) < LEAST_EPISODES or steps < _LEAST_STEPS:
        return _Modelled()
    recorded = look_at(transitions, task, seed)
    rolled = roll_out(recorded, actor, discount, fits, seed)
    support = model_support(recorded, rolled, replay(recorded, seed), seed)
    random = np.random.default_rng(seed)
    shares = rolled.success.mean(axis=1)
    success = Estimate(float(shares.mean()), float(shares.min()), float(shares.max()))
    return _Modelled(_around(rolled.returns, random), _around(rolled.returns - earned, random), success, support)


def _around(numbers: Array, random: np.random.Generator) -> Estimate:
    """Return the mean of numbers (models, episodes), and an interval that covers those of both kinds of models."""
    kinds = [estimate(half, random) for half in np.split(numbers, 2)]
    return Estimate(float(numbers.mean()), min(kind.low for kind in kinds), max(kind.high for kind in kinds))


def _bounds(task: NavigationTask) -> tuple[float, float]:
    """Return the least and the largest return that an episode can still pay, whether or not a bag shows it."""
    paid = terminal_reward(np.arange(len(Outcome)), task.rewards)
    return float(paid.min()), float(paid.max())


def _robust(
    transitions: Transitions, fitted: list[PolicyValues], ratios: Array, discount: float
) -> tuple[Array, float]:
    found = [episode_estimates(transitions, values, ratios, discount) for values in fitted]
    return np.array([estimates for estimates, _ in found]), found[0][1]


def _times(
    transitions: Transitions, task: NavigationTask, own: NDArray[np.float32], values: StateValues | None
) -> tuple[Array, Array, Array, Array] | None:
    """Return time lost by policy and driver (episodes,), and predicted and recorded times of those that arrived.

    A command loses what it takes less the time to reach that it saves, by the equations of the task's system.
    """
    if values is None or not values.counts_time:
        return None
    system, dt = task.system.build(), task.episode.time_step
    low, high = np.array(list(task.robot.commands.values())).T
    before = values(transitions.states)
    starts = np.flatnonzero(transitions.first)
    lost = []
    for actions in (own, transitions.actions):
        ends = transitions.states
        for _ in range(4):
            ends = system.step(ends, low + 0.5 * (actions + 1.0) * (high - low), dt=0.25 * dt)
        steps = np.clip(1.0 - (values(ends) - before) / dt, 0.0, 10.0)
        lost.append(np.add.reduceat(steps, starts) / np.diff(np.append(starts, len(transitions))))
    ends_at = np.append(starts[1:], len(transitions)) - 1
    arrived = transitions.outcomes[ends_at] == 1
    taken = (ends_at - starts + 1) * dt
    return lost[0], lost[1], -before[starts][arrived], taken[arrived].astype(np.float64)
