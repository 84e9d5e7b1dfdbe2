"""The verdict on a policy that has not driven: `better`, `not shown` or `worse`, why, and what to record next.

`better` needs an estimate whose assumptions hold on the bags, a gain whose whole interval lies above 0, and a success
that is no lower than the driver's. Each rule that fails is an objection, with the drives that would answer it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

from ctrl_rl_learning.offline.evaluation.support import ModelSupport
from ctrl_rl_learning.study.results import Estimate

Verdict = Literal["better", "not shown", "worse"]
LEAST_EPISODES = 10
_LEAST_EFFECTIVE = 5.0
_LEAST_AGREEMENT = 0.8
"""Share of the attainable correlation."""
_LEAST_ATTAINABLE = 0.7
"""Correlation that counts as attainable in any case: a model of errors alone agrees with nothing, itself included."""
_LEAST_COVERAGE = 0.9
_LEAST_PIECES = 5
_MOST_OFF = 0.01
_MOST_CONTRADICTED = 0.02
_MOST_MISSED = 0.2
_MOST_OUTSIDE = 0.2
"""Share of the steps; the cautious models count each episode with such a step as lost, in any case."""
_LOSS = 0.1
"""Success that the intervals may leave open: ten in a hundred fewer."""
_MOST_ASKED = 500
_CONFIDENCE = 1.96
_OF_THE_POLICY = "10 episodes of the policy itself, under the watchdog"


class Objection(NamedTuple):
    """Why a policy may not be called better, and what to record next."""

    reason: str
    record: str


@dataclass(frozen=True)
class OfflineReport:
    """Estimates of a policy from bags, what they rest on, and the verdict.

    Attributes:
        episodes: Number of episodes in the bags.
        held_out: Number of those that the policy was not fitted to; None where its file does not say.
        driver: Discounted return that the bags show.
        driver_success: Share of the episodes that reached the goal.
        fitted_q: Return of the policy by fitted Q evaluation.
        fitted_success: Success by fitted Q evaluation; None where the roll-outs are gone by.
        doubly_robust: Return by fitted Q evaluation, corrected by what followed in the bags.
        effective_episodes: Number of episodes that the correction rests on.
        coverage: Share of the policy's actions that the driver would have given, too.
        gain: Return of the policy by fitted Q evaluation, less the driver's.
        robust_gain: The same by the doubly robust estimate.
        model: Return of the policy by roll-outs in models from the bags; None where there are none. The interval
            holds those of all models.
        model_gain: The same, less the driver's.
        model_success: Success in the roll-outs: mean, least and largest of the models.
        support: What the roll-outs rest on.
        commands: Commands of the policy that the bags do not hold, in words.
        time_lost: Time that the policy's commands lose by the value function [s/s]; None without one.
        driver_time_lost: The same of the driver's commands.
        predicted_time: Time to the goal by the value function from the starts that reached it [s]; None without one.
        recorded_time: Time that those took in the bags [s].
    """

    episodes: int
    held_out: int | None
    driver: Estimate
    driver_success: float
    fitted_q: Estimate
    fitted_success: Estimate | None
    doubly_robust: Estimate
    effective_episodes: float
    coverage: float
    gain: Estimate
    robust_gain: Estimate
    model: Estimate | None
    model_gain: Estimate | None
    model_success: Estimate | None
    support: ModelSupport | None
    commands: str
    time_lost: Estimate | None
    driver_time_lost: Estimate | None
    predicted_time: Estimate | None
    recorded_time: Estimate | None

    @property
    def by_model(self) -> bool:
        """Whether to go by the roll-outs: where the bags bear out task and motion. Else fitted Q evaluation counts."""
        return believed(self.support)

    @property
    def recommended(self) -> Estimate:
        """The estimate to go by."""
        return self.model if self.model is not None and self.by_model else self.fitted_q

    @property
    def recommended_gain(self) -> Estimate:
        """The gain to go by."""
        return self.model_gain if self.model_gain is not None and self.by_model else self.gain

    @property
    def success(self) -> Estimate:
        """The success to go by."""
        found = self.model_success if self.by_model else self.fitted_success
        assert found is not None
        return found

    @property
    def success_gain(self) -> Estimate:
        """Success of the policy less the driver's, with an interval that few episodes widen (Newcombe 1998)."""
        return difference_of_shares(self.success, self.driver_success, self.episodes)

    @property
    def objections(self) -> list[Objection]:
        """Return why the policy may not be called better; nothing where it may."""
        return [*_of_bags(self), *(_of_model(self) if self.by_model else _of_fitted_q(self)), *_of_gain(self)]

    @property
    def verdict(self) -> Verdict:
        """The verdict."""
        if not self.objections:
            return "better"
        lost = self.recommended_gain.high < 0.0 or self.success_gain.high < 0.0
        borne_out = self.by_model or (self.effective_episodes >= _LEAST_EFFECTIVE and self.robust_gain.high < 0.0)
        return "worse" if lost and borne_out and self.episodes >= LEAST_EPISODES else "not shown"

    @property
    def better(self) -> bool:
        """Whether the policy may be called better than the driver of the bags."""
        return self.verdict == "better"


def wilson(share: float, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share that `count` episodes showed (Wilson 1927)."""
    z = _CONFIDENCE**2 / count
    middle = (share + 0.5 * z) / (1.0 + z)
    half = _CONFIDENCE * math.sqrt(share * (1.0 - share) / count + 0.25 * z / count) / (1.0 + z)
    return max(0.0, middle - half), min(1.0, middle + half)


def difference_of_shares(policy: Estimate, driver: float, count: int) -> Estimate:
    """Return a share less the driver's, both of `count` episodes; the worst and the best model bound it."""
    driver_low, driver_high = wilson(driver, count)
    low = policy.low - driver - math.hypot(policy.low - wilson(policy.low, count)[0], driver_high - driver)
    high = policy.high - driver + math.hypot(wilson(policy.high, count)[1] - policy.high, driver - driver_low)
    return Estimate(policy.mean - driver, low, high)


def what_few_show(episodes: int) -> str:
    """Return what so few episodes can show, as a sentence; empty where there are enough."""
    if episodes >= LEAST_EPISODES:
        return ""
    missed = 1.0 - 0.05 ** (1.0 / episodes)
    return f"{episodes} episodes show little: what fails in {missed:.0%} of all drives may not have failed once in them"


def _of_bags(report: OfflineReport) -> Iterator[Objection]:
    few = what_few_show(report.episodes)
    if few:
        yield Objection(few, f"{LEAST_EPISODES - report.episodes} more episodes at least, with the same driver")
    if report.driver_success == 0.0:
        yield Objection(
            "the bags hold failures alone: what their driver reaches otherwise is not in them",
            "all episodes of the driver, those that reach the goal, too",
        )


def believed(support: ModelSupport | None) -> bool:
    """Return whether roll-outs may be gone by."""
    return support is not None and not list(_against_model(support))


def _against_model(support: ModelSupport) -> Iterator[Objection]:
    """Yield why roll-outs may not be believed."""
    if support.scans_off > _MOST_OFF:
        yield Objection(
            f"{support.scans_off:.1%} of the recorded ranges are not those of the task file's walls",
            "nothing yet: correct the task file first",
        )
    if support.movers > support.movers_by_law:
        yield Objection(
            f"{support.movers:.1%} of the recorded ranges end at something that moves, more than the task's movers "
            f"explain ({support.movers_by_law:.1%})",
            "nothing yet: correct 'movers' in the task file first",
        )
    if support.contradicted > _MOST_CONTRADICTED:
        yield Objection(
            f"{support.contradicted:.0%} of the episodes pass through the task file's obstacles, or collide where it "
            "has none",
            "nothing yet: correct the task file first",
        )
    enough = _LEAST_AGREEMENT * max(support.attainable, _LEAST_ATTAINABLE)
    if support.agreement < enough:
        yield Objection(
            f"recorded commands end otherwise in the model: a correlation of {support.agreement:.2f}, less than "
            f"{enough:.2f}",
            "20 more episodes, with stamps of one clock",
        )


def _of_model(report: OfflineReport) -> Iterator[Objection]:
    support = report.support
    assert support is not None
    if support.effective < _LEAST_EFFECTIVE or support.outside > _MOST_OUTSIDE:
        place = support.outside_at
        drives = _OF_THE_POLICY if place is None else f"10 episodes around x {place[0]:.1f} m, y {place[1]:.1f} m"
        yield Objection(
            f"the roll-outs rest on {support.effective:.1f} of {report.episodes} episodes, and {support.outside:.0%} "
            "of their steps lie where nobody drove",
            drives,
        )
    if support.pieces < _LEAST_PIECES or support.missed > _MOST_MISSED:
        yield Objection(
            f"{support.pieces} recorded pieces are where and as fast as the policy drives, and the model misses their "
            f"ends by {support.missed:.0%} of their way",
            f"10 episodes with {report.commands or 'the commands of the policy'}",
        )


def _of_fitted_q(report: OfflineReport) -> Iterator[Objection]:
    """Yield what forbids to go by fitted Q evaluation alone."""
    if report.support is not None:
        yield from _against_model(report.support)
    if report.effective_episodes < _LEAST_EFFECTIVE:
        yield Objection(
            f"fitted Q evaluation rests on {report.effective_episodes:.1f} of {report.episodes} episodes",
            _OF_THE_POLICY,
        )
    if report.coverage < _LEAST_COVERAGE:
        yield Objection(
            f"the driver would have given {report.coverage:.0%} of the policy's commands",
            f"10 episodes with {report.commands}" if report.commands else _OF_THE_POLICY,
        )
    if report.driver_success == 1.0:
        yield Objection("the bags hold successes alone: fitted Q evaluation cannot know what fails", _OF_THE_POLICY)
    if report.held_out == 0:
        yield Objection("the policy was fitted to each of these episodes", "10 episodes that it is not fitted to")
    if not report.robust_gain.low > 0.0:
        yield _no_gain(report, "the doubly robust estimate does", report.robust_gain)


def _of_gain(report: OfflineReport) -> Iterator[Objection]:
    name = "roll-outs in the model do" if report.by_model else "fitted Q evaluation does"
    if not report.recommended_gain.low > 0.0:
        yield _no_gain(report, name, report.recommended_gain)
    success, gain = report.success, report.success_gain
    if success.low == 0.0:
        yield Objection("the policy may never reach the goal", "nothing: learn another policy")
    elif gain.low < -_LOSS or success.low + 1.0 / report.episodes < report.driver_success:
        yield Objection(
            f"its success may be lower: {success.low:.0%} where the driver has {report.driver_success:.0%}, a "
            f"difference of {gain.low:+.0%} to {gain.high:+.0%}",
            _more(report.episodes, gain),
        )
    if report.effective_episodes >= _LEAST_EFFECTIVE and not report.robust_gain.high > 0.0:
        yield Objection(
            f"the doubly robust estimate shows a loss: {report.robust_gain.low:.3f} to {report.robust_gain.high:.3f}",
            "nothing: learn another policy",
        )
    times = report.time_lost, report.driver_time_lost
    if times[0] is not None and times[1] is not None and times[0].low > times[1].high:
        yield Objection(
            "by the value function its commands lose more time than the driver's", "nothing: learn another policy"
        )


def _no_gain(report: OfflineReport, name: str, gain: Estimate) -> Objection:
    return Objection(f"{name} not show a gain: {gain.low:.3f} to {gain.high:.3f}", _more(report.episodes, gain))


def _more(episodes: int, gain: Estimate) -> str:
    """Return how many episodes would show a gain, by the square root that intervals shrink with."""
    if not gain.mean > 0.0:
        return "nothing: learn another policy"
    needed = episodes * ((gain.mean - gain.low) / gain.mean) ** 2
    return f"{min(max(math.ceil(needed) - episodes, 10), _MOST_ASKED)} more episodes with the same driver"
