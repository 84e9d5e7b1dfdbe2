"""Learns from recorded decisions: a training run with bags as data.

    run = BagRun((Path("runs/mine/bag"),), start=Path("policy.safetensors"))
    result = train(run, RunOptions(folder, ROUNDS[run.way], final_evaluations=50))

From its own decisions, a policy continues learning with MAPPO's clipped ratios to the log-probabilities in the bag.
Decisions of a script or another policy are imitated, optionally weighted by advantage.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from ctrl_rl_learning.study import IterationMetrics, ProgressCallback, Run, RunOptions

from option_coordinator.data.bag_trajectory import Recording, TeamLayout, recordings
from option_coordinator.data.trajectory import OptionTrajectory
from option_coordinator.environments.option_env import OptionEnvironment
from option_coordinator.environments.tasks import make_environment
from option_coordinator.errors import OptionError
from option_coordinator.options.options import Agent
from option_coordinator.policies.policy_file import OptionPolicy
from option_coordinator.training.experiments.evaluation import evaluate
from option_coordinator.training.experiments.runs import Checkpoints
from option_coordinator.training.heads.heads import as_numpy
from option_coordinator.training.learners.learner import GradientLearner, Imitation, Learner
from option_coordinator.training.learners.mappo import Mappo, WeightedImitation

Way = Literal["mappo", "imitation", "weighted"]
ROUNDS: Mapping[Way, int] = {"mappo": 3, "imitation": 20, "weighted": 20}
"""Useful numbers of rounds; with more, MAPPO's policy soon leaves the distribution of its data."""
_LEARNERS: Mapping[Way, type[GradientLearner]] = {
    "mappo": Mappo,
    "imitation": Imitation,
    "weighted": WeightedImitation,
}
_VALUE_ROUNDS = 10
_SAME_RATIO = 1e-2
"""Rounding error of the initial ratios."""


@dataclass(frozen=True)
class BagRun(Run):
    """A run on recorded decisions; writes policy.safetensors (an `OptionPolicy`) to its folder.

    Each iteration makes ten passes over the data. With a task, the result has `before` and `after`, see `evaluate`.

    Attributes:
        bags: Bags to learn from.
        start: Policy to start from; None for a new one.
        task_name: Name or file of a task for evaluation; without `start`, it also defines the robots' options.
        head: Kind of a new joint policy.
        seed: Seed of everything random.
        asked: Way to learn; None for MAPPO on the policy's own decisions and imitation of others.
    """

    bags: tuple[Path, ...]
    start: Path | None = None
    task_name: str | None = None
    head: str = "table"
    seed: int = 0
    asked: Way | None = None

    @property
    def name(self) -> str:
        """Name of the run and of its folder: a digest of data and initial policy."""
        told = [self.data_digest, self.policy.digest if self.policy else self.head, self.task_name, self.seed]
        told += [self.asked] if self.asked is not None else []
        return f"bags-{hashlib.sha256(repr(told).encode()).hexdigest()[:12]}"

    @cached_property
    def policy(self) -> OptionPolicy | None:
        """The initial policy."""
        return None if self.start is None else OptionPolicy.load(self.start)

    @cached_property
    def agents(self) -> tuple[Agent, ...]:
        """The robots.

        Raises:
            OptionError: Neither a policy nor a task defines the options.
        """
        if self.policy is not None:
            return self.policy.agents
        if self.task_name is None:
            raise OptionError("bags do not name the options: give a policy with --from, or a --task")
        return make_environment(self.task_name).agents

    @cached_property
    def recordings(self) -> list[Recording]:
        """The recordings in the bags.

        Raises:
            BagError: A bag cannot be read.
            OptionError: A bag has no decisions, or those of another team.
        """
        found, team = [], TeamLayout.of(self.agents)
        for bag in self.bags:
            for recording in recordings(bag):
                recording.team.check_against(team, bag)
                found.append(recording)
        return found

    @property
    def own(self) -> list[Recording]:
        """Recordings of the initial policy."""
        return [recording for recording in self.recordings if self.policy and recording.digest == self.policy.digest]

    @property
    def way(self) -> Way:
        """The way to learn.

        Raises:
            OptionError: The policy is deterministic, so its own decisions have no information; or there are no own
                decisions for MAPPO.
        """
        if self.asked is not None and self.asked != "mappo":
            return self.asked
        if not self.own:
            if self.asked is not None:
                raise OptionError("MAPPO needs decisions of the initial policy: try --way weighted")
            return "imitation"
        if self.policy is not None and self.policy.greedy:
            raise OptionError(
                f"{self.start}: takes its most likely options, so its own decisions teach nothing: try --way weighted"
            )
        return "mappo"

    @cached_property
    def trajectory(self) -> OptionTrajectory:
        """The training data: for MAPPO the policy's own decisions, otherwise all."""
        used = self.own if self.way == "mappo" else self.recordings
        return OptionTrajectory.joined([recording.trajectory for recording in used])

    @property
    def left_out(self) -> int:
        """Number of unused decisions."""
        return sum(len(recording.trajectory) for recording in self.recordings) - len(self.trajectory)

    @cached_property
    def data_digest(self) -> str:
        """SHA-256 of all recordings, hex."""
        digest = hashlib.sha256()
        for recording in self.recordings:
            digest.update(recording.digest.encode())
            for field in fields(recording.trajectory):
                digest.update(np.ascontiguousarray(getattr(recording.trajectory, field.name)).tobytes())
        return digest.hexdigest()

    def learner(self) -> Learner:
        """Create the initial learner."""
        torch.manual_seed(self.seed)
        make = _LEARNERS[self.way]
        policy = self.policy
        if policy is None:
            return make(self.agents, self.head)
        learner = make(policy.agents, policy.head, policy.partial, presence=policy.presence)
        learner.network.load_state_dict({name: torch.from_numpy(t.copy()) for name, t in policy.tensors.items()})
        return learner

    def environment(self) -> OptionEnvironment | None:
        """Create the evaluation environment, if a task was named, with the settings of the policy's training.

        Raises:
            OptionError: The task has other robots.
        """
        if self.task_name is None:
            return None
        learnt = self.policy.manifest if self.policy is not None else {}
        how = {name: learnt[name] for name in ("synchronisation", "level", "sight", "drop") if name in learnt}
        environment = make_environment(self.task_name, **how)
        if TeamLayout.of(environment.agents) != TeamLayout.of(self.agents):
            raise OptionError(f"task '{self.task_name}' is for other robots than {self.start}")
        return environment

    def fingerprint(self, options: RunOptions) -> dict[str, Any]:
        """Return everything the run depends on: data, policy and settings."""
        return {
            "way": self.way,
            "from": self.policy.digest if self.policy is not None else "",
            "data": self.data_digest,
            "decisions": len(self.trajectory),
            "left_out": self.left_out,
            "task": self.task_name or "",
            "seed": self.seed,
            "iterations": options.iterations,
            "evaluations": options.final_evaluations,
            "settings": asdict(self.learner().settings),
        }

    @contextmanager
    def begin(self, options: RunOptions, _: ProgressCallback) -> Iterator[_Trainer]:
        """Yield the trainer."""
        yield _Trainer(self, options, self.learner())

    def words(self, point: IterationMetrics) -> str:
        """Format the metrics of the iteration."""
        return ", ".join(f"{name} {figure:.2f}" for name, figure in point["update"].items())


class _Trainer(Checkpoints):
    """A learner as a `Trainer`."""

    def __init__(self, run: BagRun, options: RunOptions, learner: Learner) -> None:
        self._run = run
        self._options = options
        self._learner = learner
        self._judged_before = self._judge()

    def iterate(self, curve: Sequence[IterationMetrics], /) -> IterationMetrics:
        """Make the passes over the data; before the first iteration, fit the value function."""
        generator = np.random.default_rng((self._run.seed, len(curve)))
        torch.manual_seed(int(generator.integers(2**31)))
        learner, trajectory = self._learner, self._run.trajectory
        if isinstance(learner, Mappo) and not curve:
            for _ in range(_VALUE_ROUNDS):
                learner.learn_value(trajectory, generator)
        figures = learner.learn(trajectory, generator)
        if not curve and self._run.way == "mappo" and figures.get("ratio", 0.0) > _SAME_RATIO:
            raise OptionError(f"{self._run.start}: the log-probabilities in the bags do not match it")
        return {"update": figures}

    def finish(self, folder: Path, /) -> dict[str, Any]:
        """Write the policy, and evaluate it if there is a task."""
        run, learner = self._run, self._learner
        policy = run.policy
        OptionPolicy(
            agents=run.agents,
            head=run.head if policy is None else policy.head,
            partial=policy is not None and policy.partial,
            tensors=as_numpy(learner.network),
            presence=policy is not None and policy.presence,
            manifest={
                **(policy.manifest if policy is not None else {}),
                "learnt_from_bags": run.way,
                "data": run.data_digest,
                "from": policy.digest if policy is not None else "",
            },
        ).save(folder / "policy.safetensors")
        return {"before": self._judged_before, "after": self._judge()} if run.task_name else {}

    def _judge(self) -> dict[str, dict[str, float]]:
        environment = self._run.environment()
        if environment is None:
            return {}
        policy = self._learner.behaviour(1.0)
        return evaluate(environment, policy, policy, self._options.final_evaluations, self._run.seed)
