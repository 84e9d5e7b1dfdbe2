"""The closed loop: drive, record, relabel, learn from bags alone, evaluate offline, drive again, compare.

In round 0 a scripted driver drives. Each later round learns from the bags of all earlier rounds and records drives of
the new policy with some noise. An interrupted run resumes after its last finished step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np
from ctrl_rl_learning.offline import (
    TIME_TO_REACH,
    LearningSettings,
    NoisyPolicy,
    RandomDriver,
    ScriptedDriver,
    StateValues,
    Transitions,
    clearance_of,
    drive,
    evaluate_offline,
    find_time_to_reach,
    learn,
    load_transitions,
    load_values,
)
from ctrl_rl_learning.study import Study

from ctrl_rl_core import Actor, NavigationTask, ValueFunction, load_policy, task_digest
from ttr_reward_node import RewardEvaluator, load_value, relabel

DISCOUNT = 0.99
_TEST_SEED = 1_000_000
_SEEDS_APART = 10_000


@dataclass(frozen=True)
class LoopSettings:
    """Settings of a loop.

    Attributes:
        method: Learning method, one of `METHODS`.
        rounds: Number of rounds after the scripted driver's round.
        episodes: Number of recorded episodes per round.
        tests: Number of test episodes per policy.
        updates: Number of network updates.
        noise: Noise of the recorded drives, see `NoisyPolicy`.
        engine: Name of the physics engine, one of `sim_bridge.ENGINES`.
        seed: Seed of all random numbers.
        fit_updates: Number of updates of the offline evaluation.
        clearance: Clearance to obstacles in the value function that teaches [m]; None for half the body's radius.
    """

    method: str
    rounds: int = 3
    episodes: int = 150
    tests: int = 100
    updates: int = 5000
    noise: float = 0.25
    engine: str = "planar"
    seed: int = 0
    fit_updates: int = 500
    clearance: float | None = None


def run_loop(
    task: NavigationTask, folder: Path, settings: LoopSettings, values_folder: Path, tell: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Return the results of each round, as JSON: driven success and return, and the prediction from the bags.

    Args:
        task: Task of a robot on wheels with a time to reach.
        folder: Folder of the run.
        settings: Settings of the loop.
        values_folder: Folder of times to reach; missing ones are solved.
        tell: Callback for a line about each round.

    Raises:
        CtrlRlError: The task cannot be driven or has no time to reach; a file of an earlier call is damaged, or that
            call had other settings than a number of rounds.
    """
    study = Study(folder)
    study.require_same({"task": task_digest(task)} | asdict(replace(settings, rounds=0)))
    function = load_value(find_time_to_reach(task, values_folder))
    values = load_values(TIME_TO_REACH, task, values_folder, clearance_of(task, settings.clearance))
    bags = [folder / f"round_{number}" / "labelled" for number in range(settings.rounds + 1)]

    def play(number: int, here: Path) -> dict[str, Any]:
        result: dict[str, Any] = {"round": number}
        driver, tester = _drivers(task, here, bags[:number], settings, values, number, result)
        seed = _SEEDS_APART * (settings.seed + 1) + number * settings.episodes
        _record(task, driver, settings, here, seed, RewardEvaluator(task, function), function)
        tested = drive(task, tester, settings.tests, _TEST_SEED + _SEEDS_APART * settings.seed, engine=settings.engine)
        return result | {
            "success": tested.success.tolist(),
            "returns": tested.returns(DISCOUNT).tolist(),
            "outcomes": np.bincount(tested.outcomes, minlength=5).tolist(),
        }

    rounds = []
    for found in study.rounds(settings.rounds, play):
        tell(f"round {found['round']}: success {np.mean(found['success']):.2f}{_told(found)}")
        rounds.append(found)
    return rounds


def _drivers(
    task: NavigationTask,
    here: Path,
    bags: list[Path],
    settings: LoopSettings,
    values: StateValues,
    number: int,
    result: dict[str, Any],
) -> tuple[RandomDriver, RandomDriver]:
    """Return the driver to record and the driver to test."""
    if not bags:
        return ScriptedDriver(task), ScriptedDriver(task)
    file = here / "policy.safetensors"
    transitions = load_transitions(bags, task)
    if not file.exists():
        how = LearningSettings(settings.method, updates=settings.updates, seed=settings.seed + 100 * number)
        learn(transitions, task, how, values, {"round": number}).save(file)
    result |= _predict(transitions, task, file, values, settings)
    policy = load_policy(file)
    return NoisyPolicy(policy, settings.noise), NoisyPolicy(policy)


def _predict(
    transitions: Transitions, task: NavigationTask, file: Path, values: StateValues, settings: LoopSettings
) -> dict[str, Any]:
    """Return the prediction from the bags for a policy, relative to the driver of the last round."""
    report = evaluate_offline(
        transitions, task, Actor.load(file), values, discount=DISCOUNT, updates=settings.fit_updates, fits=2
    )
    return {
        "predicted": vars(report.recommended),
        "doubly_robust": vars(report.doubly_robust),
        "gain": vars(report.gain),
        "better": report.better,
    }


def _record(
    task: NavigationTask,
    driver: RandomDriver,
    settings: LoopSettings,
    here: Path,
    seed: int,
    evaluator: RewardEvaluator,
    function: ValueFunction,
) -> None:
    """Record drives and relabel them."""
    bag, labelled = here / "bag", here / "labelled"
    for left in (bag, labelled):  # left by an interrupted call
        rmtree(left, ignore_errors=True)
    drive(task, driver, settings.episodes, seed, bag, settings.engine)
    relabel(bag, labelled, function, evaluator)


def _told(result: dict[str, Any]) -> str:
    if "predicted" not in result:
        return ", the scripted driver"
    word = "better" if result["better"] else "not shown to be better"
    return f", predicted return {result['predicted']['mean']:.0f}, driven {np.mean(result['returns']):.0f}: {word}"
