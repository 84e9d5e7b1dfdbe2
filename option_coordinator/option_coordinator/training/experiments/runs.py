"""The runs of thesis 5.3: a method on a task, from one seed, in iterations of new episodes.

result = train(OptionRun("tool_delivery", "async", 0), RunOptions(Path("runs/options"), 25, 2000, 0, 50))
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from ctrl_rl_learning.study import IterationMetrics, ProgressCallback, Run, RunOptions, find_method
from ctrl_rl_learning.torch import load_arrays, restore_state, save_arrays, state_arrays

from ctrl_rl_core import task_digest
from option_coordinator.environments.option_env import OptionEnvironment
from option_coordinator.environments.roll_out import RollOut
from option_coordinator.environments.tasks import OptionTask, discount_of, load_option_task, make_environment
from option_coordinator.environments.tasks.water_filling import Sight
from option_coordinator.errors import OptionError
from option_coordinator.policies.policy_file import OptionPolicy
from option_coordinator.training.experiments.evaluation import evaluate, summary
from option_coordinator.training.experiments.methods import METHODS, Method
from option_coordinator.training.heads.heads import as_numpy
from option_coordinator.training.learners.learner import Learner
from option_coordinator.training.learners.mac_dqn import MacDqn
from option_coordinator.training.learners.mappo import Mappo

_MEMORY = "memory."


class Checkpoints:
    """Saves and loads the learner of a `Trainer`."""

    _learner: Learner

    def save(self, path: Path, progress: Mapping[str, Any], /) -> None:
        """Write a checkpoint; `progress` is further state as JSON."""
        arrays = state_arrays(self._learner.networks, self._learner.optimizers)
        arrays |= {f"{_MEMORY}{name}": array for name, array in self._learner.memory().items()}
        save_arrays(path, arrays, progress)

    def load(self, path: Path, /) -> dict[str, Any]:
        """Restore the learner from a checkpoint and return the progress.

        Raises:
            Exception: One of `ctrl_rl_learning.study.trainer.UNUSABLE`.
        """
        arrays, progress = load_arrays(path)
        restore_state(self._learner.networks, self._learner.optimizers, arrays)
        self._learner.recall({n.removeprefix(_MEMORY): a for n, a in arrays.items() if n.startswith(_MEMORY)})
        return progress


@dataclass(frozen=True)
class OptionRun(Run):
    """A run of one of the `METHODS`; writes policy.safetensors (an `OptionPolicy`) to its folder.

    A point of the curve has samples, `learning` (`summary` of the episodes that ended in it) and the maxima of the
    metrics of each `update`; the result has `final` (see `evaluate`) and `used`, the use the policy was trained for.
    The samples in `RunOptions` are multiplied by the method's budget.

    Attributes:
        task_name: Name or file of the task.
        method_name: One of `METHODS`.
        seed: Seed of everything random.
        sight: Observation of Water Filling's robots.
        drop: Probability of a robot's temporary drop-out in an episode; if positive, the policy observes which robots
            are present.
    """

    task_name: str
    method_name: str
    seed: int
    sight: Sight = "features"
    drop: float = 0.0

    @property
    def name(self) -> str:
        """Name of the run and of its folder."""
        seen = "" if self.sight == "features" else f"-{self.sight}"
        dropped = f"-drop{self.drop:g}" if self.drop else ""
        return f"{self.task.name}-{self.method_name}{seen}{dropped}-s{self.seed}"

    @cached_property
    def task(self) -> OptionTask:
        """The task."""
        return load_option_task(self.task_name)

    @property
    def method(self) -> Method:
        """The method.

        Raises:
            OptionError: The method is unknown.
        """
        method: Method = find_method(METHODS, self.method_name, OptionError)
        return method

    @property
    def description(self) -> dict[str, Any]:
        """Description of the run for its result and policy, as JSON."""
        return {
            "task": self.task.name,
            "task_digest": task_digest(self.task),
            "method": self.method_name,
            "seed": self.seed,
            "sight": self.sight,
            "drop": self.drop,
            "level": self.method.level,
            "synchronisation": self.method.synchronisation,
        }

    @property
    def budget(self) -> int:
        """Budget of low-level samples, as a multiple of the task's usual number."""
        return self.method.budget.get(self.task.kind, 1)

    def environment(self) -> OptionEnvironment:
        """Create the environment.

        Raises:
            OptionError: The task does not support the requested images, options or drop-outs.
        """
        method = self.method
        if self.drop and (method.partial or method.learner != "mappo"):
            raise OptionError(f"method '{self.method_name}' does not support drop-outs: omit --drop")
        return make_environment(
            self.task_name, method.synchronisation, level=method.level, sight=self.sight, drop=self.drop
        )

    def learner(self) -> Learner:
        """Create the untrained learner."""
        torch.manual_seed(self.seed)
        agents = self.environment().agents
        if self.method.learner == "mac_dqn":
            return MacDqn(agents)
        return Mappo(agents, self.method.head, self.method.partial, presence=self.drop > 0.0)

    def batch(self, learner: Learner) -> int:
        """Return the number of low-level samples between two updates."""
        return learner.settings.update_samples if isinstance(learner, MacDqn) else self.task.batch_samples

    def policy(self, learner: Learner, figures: dict[str, Any]) -> OptionPolicy:
        """Return the learnt policy for saving."""
        return OptionPolicy(
            agents=self.environment().agents,
            head=self.method.head,
            partial=self.method.partial,
            tensors=as_numpy(learner.network),
            presence=self.drop > 0.0,
            greedy=learner.greedy,
            manifest={**self.description, **figures},
        )

    def fingerprint(self, options: RunOptions) -> dict[str, Any]:
        """Return description and settings."""
        return {
            **self.description,
            "iterations": options.iterations,
            "samples": options.samples,
            "evaluations": options.final_evaluations,
            "discount": discount_of(self.task),
            "settings": asdict(self.learner().settings),
        }

    @contextmanager
    def begin(self, options: RunOptions, _: ProgressCallback) -> Iterator[_Trainer]:
        """Yield the trainer."""
        yield _Trainer(self, options, self.learner())

    def words(self, point: IterationMetrics) -> str:
        """Format the mean return of the iteration's episodes."""
        returned = point["learning"].get("return")
        return "" if returned is None else f"return {returned:.0f}"


class _Trainer(Checkpoints):
    """A learner as a `Trainer`."""

    def __init__(self, run: OptionRun, options: RunOptions, learner: Learner) -> None:
        self._run = run
        self._options = options
        self._learner = learner

    def iterate(self, curve: Sequence[IterationMetrics], /) -> IterationMetrics:
        """Learn from new episodes in batches of similar size; excess samples of earlier iterations are deducted."""
        run, learner, done = self._run, self._learner, len(curve)
        taken = int(curve[-1]["samples"]) if curve else 0
        samples = max(1, (done + 1) * self._options.samples * run.budget - taken)
        generator = np.random.default_rng((run.seed, done))
        torch.manual_seed(int(generator.integers(2**31)))
        roll_out = RollOut(run.environment(), generator)
        figures: dict[str, float] = {}
        for left in range(max(1, round(samples / run.batch(learner))), 0, -1):
            progress = (done + roll_out.samples / samples) / self._options.iterations
            wanted = max(1, (samples - roll_out.samples) // left)
            found = learner.learn(roll_out.collect(learner.behaviour(progress), wanted), generator)
            figures = {name: max(figure, figures.get(name, figure)) for name, figure in found.items()}
        return {"samples": taken + roll_out.samples, "learning": summary(roll_out.finished), "update": figures}

    def finish(self, folder: Path, /) -> dict[str, Any]:
        """Evaluate the policy to be saved, and write it."""
        run, learner = self._run, self._learner
        best = run.policy(learner, {}).joint
        final = evaluate(run.environment(), learner.behaviour(1.0), best, self._options.final_evaluations, run.seed)
        told = {"final": final, "used": "mode" if learner.greedy else "draws"}
        run.policy(learner, told).save(folder / "policy.safetensors")
        return told


def option_runs(
    task_name: str, methods: Sequence[str], seeds: int, sight: Sight = "features", drop: float = 0.0
) -> list[OptionRun]:
    """Return all runs of a task, the most important ones first."""
    ordered = sorted(set(methods), key=list(METHODS).index)
    return [OptionRun(task_name, method, seed, sight, drop) for method in ordered for seed in range(seeds)]
