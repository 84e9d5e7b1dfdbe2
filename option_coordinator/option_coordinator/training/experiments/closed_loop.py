"""The closed loop of a team: play, record, learn from the bags alone, play again, compare.

Round 0 is a careless script. Each later round learns from all earlier bags by weighted imitation, and records samples
of its policy. An interrupted run continues where it stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from shutil import rmtree
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_learning.study import RunOptions, Study, train
from numpy.typing import NDArray

from option_coordinator.data.team_bag import TeamBag
from option_coordinator.environments.option_env import OptionEnvironment
from option_coordinator.environments.roll_out import OptionEpisode, play_episodes
from option_coordinator.environments.tasks import make_environment
from option_coordinator.options.options import Decision
from option_coordinator.policies.policy_file import OptionPolicy
from option_coordinator.scripted.task_policies import DecisionPolicy, RandomPolicy, scripted_policy
from option_coordinator.training.experiments.bag_runs import ROUNDS, BagRun
from option_coordinator.training.experiments.evaluation import fresh, summary
from option_coordinator.training.experiments.offline_evaluation import evaluate_offline

_SEEDS_APART = 100_000


class Choice(NamedTuple):
    """Options chosen by a driver of the team.

    Attributes:
        options: Joint option (N,).
        log_prob: Log-probability of the chosen options; 0 for a script.
    """

    options: NDArray[np.int64]
    log_prob: float = 0.0


@dataclass(frozen=True)
class LoopSettings:
    """Settings of a loop.

    Attributes:
        rounds: Number of rounds after the script's.
        episodes: Number of recorded episodes per round.
        tests: Number of evaluation episodes per round.
        careless: Probability that the script takes a random legal option.
        seed: Seed of everything random.
        fit_updates: Number of updates in each of the two fits of the offline evaluation.
    """

    rounds: int = 3
    episodes: int = 100
    tests: int = 50
    careless: float = 0.5
    seed: int = 0
    fit_updates: int = 800


class CarelessScript:
    """The task's script, which sometimes takes a random legal option."""

    digest = ""

    def __init__(self, environment: OptionEnvironment, careless: float, seed: int) -> None:
        self._script: DecisionPolicy = scripted_policy(environment)
        self._any: DecisionPolicy = RandomPolicy(seed)
        self._careless = careless
        self._generator = np.random.default_rng((seed, 1))

    def __call__(self, decision: Decision) -> Choice:
        """Return the script's options, some of them replaced by random ones."""
        named = self._script(decision)
        wild = self._any(decision)
        options = decision.running.copy()
        for index, agent in enumerate(decision.agents):
            if not decision.choosing[index]:
                continue
            said = named[agent.name]
            careful = self._generator.uniform() >= self._careless and decision.legal[index, said]
            options[index] = said if careful else wild[agent.name]
        return Choice(options)


class DrawnPolicy:
    """A policy that samples its options."""

    def __init__(self, policy: OptionPolicy, seed: int) -> None:
        self.digest = policy.digest
        self._joint, self._generator = policy.joint, np.random.default_rng((seed, 2))

    def __call__(self, decision: Decision) -> Choice:
        """Sample options, with their log-probability."""
        conditional = self._joint.valid(decision)
        options = conditional.sample(self._generator)
        return Choice(options, float(conditional.log_prob(options)))


Driver = CarelessScript | DrawnPolicy


def run_loop(task: str, folder: Path, settings: LoopSettings, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    """Run the loop; return each round's `evaluation.summary`, and the `returns` of its episodes.

    Args:
        task: Name or file of a task of a team.
        folder: Folder of the run.
        settings: Settings of the loop.
        tell: Called with a line about each round.

    Raises:
        CtrlRlError: The task does not exist, a file of an earlier call is damaged, that call had other settings than a
            number of rounds, or writing fails.
    """
    study = Study(folder)
    study.require_same({"task": task} | asdict(replace(settings, rounds=0)))
    bags = [folder / f"round_{number}" / "bag" for number in range(settings.rounds + 1)]

    def work(number: int, here: Path) -> dict[str, Any]:
        seed = _SEEDS_APART * (settings.seed + 1) + number * settings.episodes
        environment = make_environment(task)
        result: dict[str, Any] = {"round": number}
        driver = _driver(task, environment, here, bags[:number], settings, seed, result)
        rmtree(here / "bag", ignore_errors=True)  # left by an interrupted call
        with TeamBag(here / "bag", environment.discount) as bag:
            for _ in play(environment, driver, range(seed, seed + settings.episodes), bag):
                pass
        tested = list(play(environment, driver, fresh(settings.tests)))
        return result | {**summary(tested), "returns": [episode.returned for episode in tested]}

    rounds = []
    for told in study.rounds(settings.rounds, work):
        rounds.append(told)
        word = "" if "better" not in told else f", {'' if told['better'] else 'not '}called better before"
        tell(
            f"round {told['round']}: return {told['return']:.4g}, {told['steps']:.4g} steps, "
            f"done {told['terminated']:.0%}{word}"
        )
    return rounds


def play(
    environment: OptionEnvironment, driver: Driver, seeds: range, bag: TeamBag | None = None
) -> Iterator[OptionEpisode]:
    """Play one episode per seed, and record it if a bag is given."""

    def choose(decision: Decision) -> dict[str, int]:
        choice = driver(decision)
        if bag is not None:
            bag.put(decision, choice.options, choice.log_prob, driver.digest)
        return decision.named(choice.options)

    def at_end(decision: Decision) -> None:
        if bag is not None:
            bag.put(decision, decision.running)

    return play_episodes(environment, choose, seeds, at_end)


def _driver(
    task: str,
    environment: OptionEnvironment,
    here: Path,
    bags: list[Path],
    settings: LoopSettings,
    seed: int,
    result: dict[str, Any],
) -> Driver:
    """Return the script, or a policy learnt from the bags so far; its offline evaluation is added to `result`."""
    if not bags:
        return CarelessScript(environment, settings.careless, seed)
    run = BagRun(tuple(bags), None, task, seed=settings.seed, asked="weighted")
    train(run, RunOptions(here / "learning", ROUNDS["weighted"], final_evaluations=0))
    policy = OptionPolicy.load(here / "learning" / run.name / "policy.safetensors")
    report = evaluate_offline(run.recordings, policy, updates=settings.fit_updates, fits=2, seed=seed)
    result |= {"predicted": vars(report.policy), "gain": vars(report.gain), "better": report.better}
    return DrawnPolicy(policy, seed)
