"""What a policy would earn, with intervals, beside what the bags show; and whether it may be called better.

report = evaluate_offline(transitions, task, actor, values)
report.better      # False unless every method that can tell says so
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Actor, NavigationTask
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.data.transitions import Transitions
from ctrl_rl_learning.offline.data.values import StateValues
from ctrl_rl_learning.offline.evaluation.estimators import (
    PolicyValues,
    actions_of,
    episode_estimates,
    fit_values,
    step_ratios,
)
from ctrl_rl_learning.offline.evaluation.roll_outs import can_model, model_returns, replay_correlation
from ctrl_rl_learning.offline.learners.learning import learn
from ctrl_rl_learning.offline.learners.settings import LearningSettings
from ctrl_rl_learning.study.results import Estimate, estimate

Array = NDArray[np.float64]
_LEAST_EPISODES = 10
_LEAST_EFFECTIVE = 5.0
_LEAST_REPLAYED = 0.8


@dataclass(frozen=True)
class OfflineReport:
    """Estimates of a policy from bags.

    Attributes:
        driver: Discounted return that the bags show.
        fitted_q: Return of the policy by fitted Q evaluation.
        doubly_robust: The same, corrected by what followed in the bags.
        effective_episodes: Number of episodes that the correction rests on.
        gain: Return of the policy by fitted Q evaluation, less the driver's.
        robust_gain: The same by the doubly robust estimate.
        model: Return of the policy by roll-outs in a model from the bags; None where `can_model` says no.
        model_gain: The same, less the driver's.
        replayed: Correlation by which recorded commands end in the model as in the bags; no policy takes part.
        time_lost: Time that the policy's commands lose by the value function [s/s]; None without one.
        driver_time_lost: The same of the driver's commands.
        predicted_time: Time to the goal by the value function from the starts that reached it [s]; None without one.
        recorded_time: Time that those took in the bags [s].
    """

    driver: Estimate
    fitted_q: Estimate
    doubly_robust: Estimate
    effective_episodes: float
    gain: Estimate
    robust_gain: Estimate
    model: Estimate | None
    model_gain: Estimate | None
    replayed: float
    time_lost: Estimate | None
    driver_time_lost: Estimate | None
    predicted_time: Estimate | None
    recorded_time: Estimate | None

    @property
    def by_model(self) -> bool:
        """Whether to go by the roll-outs: where the model replays the bags. Else fitted Q evaluation counts."""
        return self.model is not None and self.replayed >= _LEAST_REPLAYED

    @property
    def recommended(self) -> Estimate:
        """The estimate to go by."""
        return self.model if self.model is not None and self.by_model else self.fitted_q

    @property
    def objections(self) -> list[str]:
        """Return why the policy may not be called better; nothing where it may."""
        out = []
        name, gain = "fitted Q evaluation does", self.gain
        if self.model_gain is not None and self.by_model:
            name, gain = "roll-outs in the model do", self.model_gain
        if not gain.low > 0.0:
            out.append(f"{name} not show a gain: {gain.low:.3f} to {gain.high:.3f}")
        if self.effective_episodes >= _LEAST_EFFECTIVE and not self.robust_gain.high > 0.0:
            out.append(
                f"the doubly robust estimate shows a loss: {self.robust_gain.low:.3f} to {self.robust_gain.high:.3f}"
            )
        times = self.time_lost, self.driver_time_lost
        if times[0] is not None and times[1] is not None and times[0].low > times[1].high:
            out.append("by the value function its commands lose more time than the driver's")
        return out

    @property
    def better(self) -> bool:
        """Whether the policy may be called better than the driver of the bags."""
        return not self.objections


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
        LearningError: There are too few episodes, or the policy observes something else.
    """
    starts = np.flatnonzero(transitions.first)
    if len(starts) < _LEAST_EPISODES:
        raise LearningError(f"the bags have {len(starts)} episodes: at least {_LEAST_EPISODES} are needed")
    if len(actor.middle) != transitions.observations.shape[1]:
        raise LearningError(
            f"the policy observes {len(actor.middle)} numbers, the task's policies "
            f"{transitions.observations.shape[1]}: it is another task's"
        )
    random = np.random.default_rng(seed)
    fitted = [fit_values(transitions, actor, discount, updates, seed + k, tell) for k in range(fits)]
    clone = learn(transitions, task, LearningSettings("bc", updates=max(200, updates // 5), seed=seed))
    own, cloned = (actions_of(each, transitions.observations) for each in (actor, clone))
    ratios = step_ratios(transitions, cloned, own)
    earned = transitions.returns(discount)
    first = np.array([each.before[starts] for each in fitted])
    robust, effective = _robust(transitions, fitted, ratios, discount)
    times = _times(transitions, task, own, values)
    modelled, replayed = None, 0.0
    if can_model(task):
        modelled = model_returns(transitions, task, actor, discount, fits, seed)
        replayed = replay_correlation(transitions, task, seed)
    return OfflineReport(
        driver=estimate(earned[None], random),
        fitted_q=estimate(first, random),
        doubly_robust=estimate(robust, random),
        effective_episodes=effective,
        gain=estimate(first - earned, random),
        robust_gain=estimate(robust - earned, random),
        model=None if modelled is None else estimate(modelled, random),
        model_gain=None if modelled is None else estimate(modelled - earned, random),
        replayed=replayed,
        time_lost=None if times is None else estimate(times[0][None], random),
        driver_time_lost=None if times is None else estimate(times[1][None], random),
        predicted_time=None if times is None or not len(times[2]) else estimate(times[2][None], random),
        recorded_time=None if times is None or not len(times[3]) else estimate(times[3][None], random),
    )


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
