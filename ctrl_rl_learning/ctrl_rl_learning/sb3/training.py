"""Training with Stable-Baselines3: iterations of new episodes, an evaluation after each, and the exported policy.

result = train(run, RunOptions(Path("runs/mine"), 10, 10240, 20, 50))        # run: a `SimulatedRun`
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from ctrl_rl_core import (
    Actor,
    Episode,
    NavigationTask,
    Outcome,
    PolicyError,
    PolicyManifest,
    interface_of,
    task_digest,
)
from ctrl_rl_learning.sb3.algorithms import REWARD_SCALE, extract_actor, number_of_environments
from ctrl_rl_learning.sb3.checkpoint import load_checkpoint, save_checkpoint
from ctrl_rl_learning.sb3.environment import DEPLOYED_RATE, SUCCESS, Environment, evaluate, observation_names
from ctrl_rl_learning.sb3.fleet import FleetEnvironments, FleetReward, evaluate_in_fleet
from ctrl_rl_learning.sb3.records import Visits, entropy_of, listen
from ctrl_rl_learning.study.run import IterationMetrics, ProgressCallback, Run, RunOptions

Tester = Callable[[Actor, int, int], Sequence[Episode[Any]]]
"""Function of policy, number of episodes and first seed that returns the episodes."""
_EVALUATION_SEED = 1_000_000


class SimulatedRun(Run):
    """Training run in a simulated task, with a fleet in the planar engine or one robot at a time.

    A finished run leaves policy.safetensors (an `Actor`) and visits.safetensors (`Visits`) in its folder. Each point of
    the curve has samples, episodes and their outcomes, success rate and mean undiscounted return of the evaluation,
    `losses` (see `LossLogger.take`) and `notes`. The result has `success`, `returns` and outcomes (`ended`) of the last
    evaluation, and `paths`, the states of its first episodes.

    Attributes:
        seed: Seed of all random numbers.
    """

    seed: int

    if TYPE_CHECKING:  # dataclass fields of subclasses would take a property as their default

        @property
        def task(self) -> NavigationTask:
            """Task to learn."""

    @property
    @abstractmethod
    def description(self) -> dict[str, Any]:
        """Description of the run in its result and its policy, as JSON."""

    @abstractmethod
    def environment(self, rate: int | None = None) -> Environment:
        """Return one robot's environment at a physics rate [Hz], see `make_environment`."""

    @property
    def in_fleet(self) -> bool:
        """Whether training and its evaluations use a fleet, which the task must fit (see `fits_fleet`)."""
        return False

    @property
    def timeout_ends(self) -> bool:
        """Whether a time-out ends the return, see `FleetEnvironments`."""
        return False

    def fleet_reward(self, _robots: int, /) -> FleetReward | None:
        """Return the reward for a fleet of the given size; None for the task's own rewards."""
        return None

    def environments(self, algorithm: str) -> VecEnv | Callable[[], Environment]:
        """Return the argument `make` of `make_algorithm`."""
        if not self.in_fleet:
            return self.environment
        robots = number_of_environments(algorithm)
        return FleetEnvironments(self.task, robots, self.fleet_reward(robots), timeout_ends=self.timeout_ends)

    @abstractmethod
    def model(self, samples: int) -> BaseAlgorithm:
        """Return the untrained algorithm with its environments, for a total number of samples."""

    @contextmanager
    def tester(self) -> Iterator[Tester]:
        """Yield the function that evaluates policies during training; it creates the simulation once and reuses it."""
        if self.in_fleet:
            yield lambda actor, episodes, seed: evaluate_in_fleet(
                actor, self.task, range(seed, seed + episodes), self.fleet_reward(episodes)
            )
            return
        with ExitStack() as opened:
            kept: list[Environment] = []

            def test(actor: Actor, episodes: int, seed: int) -> Sequence[Episode[Any]]:
                if episodes and not kept:
                    kept.append(self.environment())
                    opened.callback(kept[0].close)
                return evaluate(actor, kept[0], episodes, seed) if episodes else []

            yield test

    def notes(self, _: BaseAlgorithm, /) -> dict[str, Any]:
        """Return additional figures for a point of the curve, as JSON; called after each iteration."""
        return {}

    def fingerprint(self, _: RunOptions) -> dict[str, Any]:
        """Return the run's description and the digest of its task."""
        return {**self.description, "task_digest": task_digest(self.task)}

    def words(self, point: IterationMetrics) -> float:
        """Return the success rate of the evaluation."""
        return float(point["evaluation"])

    @contextmanager
    def begin(self, options: RunOptions, _: ProgressCallback) -> Iterator[_Trainer]:
        """Yield the trainer with its environments."""
        model = self.model(options.samples * options.iterations)
        try:
            with self.tester() as test:
                yield _Trainer(self, options, model, test)
        finally:
            if model.env is not None:
                model.env.close()


class _Trainer:
    """`Trainer` for an algorithm of Stable-Baselines3."""

    def __init__(self, run: SimulatedRun, options: RunOptions, model: BaseAlgorithm, test: Tester) -> None:
        self._run = run
        self._options = options
        self._model = model
        self._test = test
        self._visits, self._logger = Visits(run.task), listen(model)

    def iterate(self, curve: Sequence[IterationMetrics], /) -> IterationMetrics:
        run, model, options = self._run, self._model, self._options
        outcomes = _iterate(model, _seed_of(run.seed, len(curve)), options.samples, self._visits)
        losses = self._logger.take() | entropy_of(model)
        actor = extract_actor(model, run.task, {})
        tested = self._test(actor, options.evaluations, _EVALUATION_SEED)
        self._visits.end_iteration()
        return {
            "samples": model.num_timesteps,
            "episodes": len(outcomes),
            "ended": _count(outcomes),
            "evaluation": _rate([episode.outcome for episode in tested]),
            "return": float(np.mean([episode.total for episode in tested])) if tested else 0.0,
            "losses": losses,
            "notes": run.notes(model),
        }

    def save(self, path: Path, progress: Mapping[str, Any], /) -> None:
        save_checkpoint(path, self._model, progress, self._visits.counts())

    def load(self, path: Path, /) -> dict[str, Any]:
        progress, arrays = load_checkpoint(path, self._model)
        self._visits = self._visits.with_counts(arrays)
        return progress

    def finish(self, folder: Path, /) -> dict[str, Any]:
        """Evaluate at the physics rate of deployed robots, and write policy and visits."""
        run = self._run
        manifest = {
            **run.fingerprint(self._options),
            "observation": observation_names(run.task),
            "commands": list(run.task.robot.commands),
        }
        actor = extract_actor(self._model, run.task, manifest)
        episodes = self._deployed_episodes(actor)
        outcomes = [episode.outcome for episode in episodes]
        metrics = {"success": _rate(outcomes), "episodes": len(outcomes)}
        told = replace(actor, manifest={**manifest, "metrics": metrics}, interface=_interface(run.task))
        told.save(folder / "policy.safetensors")
        self._visits.save(folder / "visits.safetensors")
        lasted = [len(episode.states) - 1 for episode in episodes if episode.outcome == SUCCESS]
        return {
            "success": metrics["success"],
            "ended": _count(outcomes),
            "seconds_to_goal": float(np.mean(lasted)) * run.task.episode.time_step if lasted else None,
            "returns": [episode.total for episode in episodes],
            "paths": [{"outcome": one.outcome, "states": one.states.round(4).tolist()} for one in episodes[:3]],
        }

    def _deployed_episodes(self, actor: Actor) -> Sequence[Episode[Any]]:
        count = self._options.final_evaluations
        if not count:
            return []
        with closing(self._run.environment(DEPLOYED_RATE)) as environment:
            return evaluate(actor, environment, count, 2 * _EVALUATION_SEED)


def _interface(task: NavigationTask) -> PolicyManifest | None:
    """Return the policy's interface for the node; None if no node can send its commands."""
    try:
        return interface_of(task)
    except PolicyError:
        return None


def _iterate(model: BaseAlgorithm, seed: int, samples: int, visits: Visits) -> list[str]:
    """Learn from a number of samples of new episodes, and return the recorded outcomes of the finished ones."""
    model.set_random_seed(seed)
    model._last_obs = None  # makes `learn` reset the environments
    recorder = Recorder(visits)
    model.learn(samples, callback=recorder, reset_num_timesteps=False)
    if isinstance(model, OffPolicyAlgorithm) and model.replay_buffer is not None:
        # The next row of the replay buffer belongs to another episode, so multi-step returns must end here.
        last = model.replay_buffer.pos - 1
        model.replay_buffer.timeouts[last] = np.maximum(
            model.replay_buffer.timeouts[last], model.replay_buffer.dones[last] == 0.0
        )
    return recorder.outcomes


class Recorder(BaseCallback):
    """Callback that records outcomes, returns and visited states of training episodes.

    Args:
        visits: Counter of visited states; None to skip counting.

    Attributes:
        outcomes: Outcomes of the finished episodes.
        returns: Undiscounted return of each finished episode.
    """

    def __init__(self, visits: Visits | None = None) -> None:
        super().__init__()
        self.outcomes: list[str] = []
        self.returns: list[float] = []
        self._visits, self._totals = visits, np.zeros(0)

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        if self._visits is not None:
            self._visits.add([info["state"] for info in infos])
        dones = self.locals["dones"]
        self._totals = (self._totals if len(self._totals) else np.zeros(len(dones))) + self.locals["rewards"]
        self.outcomes += [info["outcome"] for info, done in zip(infos, dones, strict=True) if done]
        self.returns += (self._totals[dones] / REWARD_SCALE).tolist()
        self._totals[dones] = 0.0
        return True


def _rate(outcomes: list[str]) -> float:
    return outcomes.count(SUCCESS) / len(outcomes) if outcomes else 0.0


def _count(outcomes: list[str]) -> dict[str, int]:
    return {outcome.name: outcomes.count(outcome.name) for outcome in Outcome if outcome}


def _seed_of(seed: int, iteration: int) -> int:
    return int(np.random.SeedSequence((seed, iteration)).generate_state(1)[0]) % 2**31
