"""Agreement between returns predicted from bags and driven returns, over many policies of varying quality.

The policies learn from the bags of one seed. Each seed's own bags give a prediction for every policy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from shutil import rmtree
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_learning.offline import (
    OC_VALUE,
    TIME_TO_REACH,
    LearningSettings,
    NoisyPolicy,
    ScriptedDriver,
    StateValues,
    Transitions,
    correlation,
    drive,
    evaluate_offline,
    find_time_to_reach,
    learn,
    load_transitions,
    load_values,
)
from ctrl_rl_learning.study import Study
from numpy.typing import NDArray

from ctrl_rl_core import Actor, NavigationTask, load_policy, task_digest
from ctrl_rl_trials.offline.closed_loop import DISCOUNT
from oc_baseline_node import shipped_values
from ttr_reward_node import RewardEvaluator, load_value, relabel

Array = NDArray[np.float64]
ESTIMATES = frozenset({"fitted_q", "doubly_robust", "time_lost", "model", "recommended"})
_TEST_SEED = 2_000_000
_SEEDS_APART = 10_000
_RESAMPLED = 2000
_TOLD = ("replayed", "better", "driver")


@dataclass(frozen=True)
class Candidate:
    """Specification of a policy: method, updates, value function, and temperature of the weights."""

    method: str
    updates: int
    value: str | None = None
    temperature: float = 0.4

    @property
    def name(self) -> str:
        """Name of the policy's file."""
        return "-".join(filter(None, (self.method, self.value, str(self.updates), str(self.temperature))))

    def within(self, updates: int) -> Candidate:
        """Return the candidate with at most a given number of updates."""
        return replace(self, updates=min(self.updates, updates))


CANDIDATES = (
    Candidate("bc", 20),
    Candidate("bc", 100),
    Candidate("bc", 500),
    Candidate("bc", 3000),
    Candidate("value_weight", 100, TIME_TO_REACH),
    Candidate("value_weight", 3000, TIME_TO_REACH),
    Candidate("value_weight", 1000, TIME_TO_REACH, 1.0),
    Candidate("value_weight", 3000, OC_VALUE),
    Candidate("value_model", 100, TIME_TO_REACH, 0.2),
    Candidate("value_model", 3000, TIME_TO_REACH, 0.2),
    Candidate("value_model", 3000, TIME_TO_REACH, 1.0),
    Candidate("value_critic", 300, TIME_TO_REACH),
    Candidate("value_critic", 1500, TIME_TO_REACH),
    Candidate("value_critic", 1000, OC_VALUE),
    Candidate("iql", 300),
    Candidate("iql", 2000),
    Candidate("td3bc", 300),
    Candidate("td3bc", 1500),
)


@dataclass(frozen=True)
class CorrelationSettings:
    """Settings of the comparison.

    Attributes:
        seeds: Number of seeds.
        episodes: Number of episodes in each seed's bag.
        tests: Number of test episodes per policy.
        updates: Maximum number of updates of a policy; candidates that differ in no other way become one.
        fit_updates: Number of updates of the offline evaluation.
        fits: Number of fits of the offline evaluation.
        engine: Name of the physics engine, one of `sim_bridge.ENGINES`.
    """

    seeds: int = 5
    episodes: int = 150
    tests: int = 100
    updates: int = max(each.updates for each in CANDIDATES)
    fit_updates: int = 1000
    fits: int = 1
    engine: str = "planar"


def compare(
    task: NavigationTask, folder: Path, settings: CorrelationSettings, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Return each policy's driven return and its predictions from the bags of each seed, as JSON.

    Args:
        task: Task of a wheeled robot with a time to reach.
        folder: Folder of the run, which resumes there.
        settings: Settings of the comparison.
        tell: Callback for a line about each policy.

    Raises:
        CtrlRlError: The task cannot be driven or has no time to reach; a file of an earlier call is damaged, or that
            call had other settings than a number of seeds.
    """
    candidates = candidates_for(task, settings.updates)
    if all(each.value != OC_VALUE for each in candidates):
        tell(f"task '{task.name}' has no optimal control value: {len(candidates)} policies learn without one")
    Study(folder).require_same({"task": task_digest(task)} | asdict(replace(settings, seeds=0)))
    values = load_values(TIME_TO_REACH, task, folder / "values")
    bags = [_bag(task, folder, seed, settings) for seed in range(settings.seeds)]
    learnt_from = load_transitions(bags[:1], task)
    driven = [_drive(task, folder, each, learnt_from, settings, tell) for each in candidates]
    predicted = []
    for seed, bag in enumerate(bags):
        transitions = learnt_from if seed == 0 else load_transitions([bag], task)
        predicted.append(
            [_predict(task, folder, each, seed, transitions, values, settings, tell) for each in candidates]
        )
    return {"policies": [each.name for each in candidates], "driven": driven, "predicted": predicted}


def candidates_for(task: NavigationTask, updates: int) -> tuple[Candidate, ...]:
    """Return the policies to compare, each with at most a given number of updates and a value that the task has."""
    usable = [each for each in CANDIDATES if each.value != OC_VALUE or task.name in shipped_values()]
    return tuple(dict.fromkeys(each.within(updates) for each in usable))


class Agreement(NamedTuple):
    """Agreement between an estimate and the driven returns.

    Attributes:
        correlation: Correlation for each seed (seeds,).
        ranks: Rank correlation for each seed (seeds,).
        regret: Return lost by choosing the policy with the best estimate, as a fraction of the difference between the
            best and the worst policy, for each seed (seeds,).
        interval: 95 % interval of the correlation over resampled policies and seeds (2,).
    """

    correlation: Array
    ranks: Array
    regret: Array
    interval: Array


def agreements(found: dict[str, Any]) -> dict[str, Agreement]:
    """Return the agreement of each estimate with the driven returns, by name."""
    driven = np.array([each["return"] for each in found["driven"]])
    random = np.random.default_rng(0)
    out = {}
    for name in sorted(ESTIMATES & found["predicted"][0][0].keys()):
        sign = -1.0 if name == "time_lost" else 1.0
        estimates = sign * np.array([[each[name] for each in predicted] for predicted in found["predicted"]])
        drawn = []
        for _ in range(_RESAMPLED):
            chosen = random.integers(len(driven), size=len(driven))
            drawn.append(correlation(estimates[random.integers(len(estimates)), chosen], driven[chosen]))
        lost = driven.max() - driven[estimates.argmax(axis=1)]
        out[name] = Agreement(
            correlation=np.array([correlation(row, driven) for row in estimates]),
            ranks=np.array([correlation(_ranks(row), _ranks(driven)) for row in estimates]),
            regret=lost / max(float(np.ptp(driven)), 1e-9),
            interval=np.quantile(drawn, (0.025, 0.975)),
        )
    return out


def _ranks(numbers: Array) -> Array:
    """Return the ranks of numbers (n,); equal numbers get their mean rank."""
    return np.asarray((numbers[:, None] > numbers).sum(axis=1) + 0.5 * (numbers[:, None] == numbers).sum(axis=1), float)


def _bag(task: NavigationTask, folder: Path, seed: int, settings: CorrelationSettings) -> Path:
    here = folder / f"bags_{seed}"
    labelled, done = here / "labelled", here / "done"
    if not done.exists():
        if here.exists():
            rmtree(here)
        here.mkdir(parents=True)
        drive(task, ScriptedDriver(task), settings.episodes, _SEEDS_APART * (seed + 1), here / "bag", settings.engine)
        function = load_value(find_time_to_reach(task, folder / "values"))
        relabel(here / "bag", labelled, function, RewardEvaluator(task, function))
        done.touch()
    return labelled


def _drive(
    task: NavigationTask,
    folder: Path,
    candidate: Candidate,
    transitions: Transitions,
    settings: CorrelationSettings,
    tell: Callable[[str], None],
) -> dict[str, Any]:
    """Train a policy and drive its test episodes."""
    file = folder / f"{candidate.name}.safetensors"

    def work() -> dict[str, float]:
        if not file.exists():
            how = LearningSettings(candidate.method, updates=candidate.updates, temperature=candidate.temperature)
            values = None if candidate.value is None else load_values(candidate.value, task, folder / "values")
            learn(transitions, task, how, values).save(file)
        drives = drive(task, NoisyPolicy(load_policy(file)), settings.tests, _TEST_SEED, engine=settings.engine)
        told = {"return": float(drives.returns(DISCOUNT).mean()), "success": float(drives.success.mean())}
        tell(f"{candidate.name}: driven, return {told['return']:.0f}, success {told['success']:.2f}")
        return told

    found = Study(folder).once(candidate.name, work)
    return {key: found[key] for key in ("return", "success")}


def _predict(
    task: NavigationTask,
    folder: Path,
    candidate: Candidate,
    seed: int,
    transitions: Transitions,
    values: StateValues,
    settings: CorrelationSettings,
    tell: Callable[[str], None],
) -> dict[str, Any]:
    """Predict a policy's return from a bag."""

    def work() -> dict[str, Any]:
        actor = Actor.load(folder / f"{candidate.name}.safetensors")
        report = evaluate_offline(
            transitions,
            task,
            actor,
            values,
            discount=DISCOUNT,
            updates=settings.fit_updates,
            fits=settings.fits,
            seed=seed,
        )
        told = {
            "fitted_q": report.fitted_q.mean,
            "doubly_robust": report.doubly_robust.mean,
            "time_lost": 0.0 if report.time_lost is None else report.time_lost.mean,
            "recommended": report.recommended.mean,
            "replayed": 0.0 if report.support is None else report.support.agreement,
            "better": report.better,
            "driver": report.driver.mean,
            **({} if report.model is None else {"model": report.model.mean}),
        }
        tell(f"{candidate.name}, seed {seed}: predicted return {told['recommended']:.0f}")
        return told

    found = Study(folder).once(f"{candidate.name}-from-{seed}", work)
    return {key: found[key] for key in (*_TOLD, *sorted(ESTIMATES & found.keys()))}
