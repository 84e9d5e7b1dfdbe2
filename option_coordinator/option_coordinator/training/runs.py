"""One run of learning: a method on a task, from one seed; may be cut off at any time.

    result = train_one(OptionRun("tool_delivery", "async", 0), RunOptions(Path("runs/options")))

It goes in iterations. Each begins with fresh episodes and draws its random numbers from the seed and its own number, so
that a run that goes on from its last checkpoint ends exactly as if it had not been cut off.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from ctrl_rl_core.tasks import task_digest
from ctrl_rl_core.whole_file import write_whole
from ctrl_rl_training.run_folder import result_file

from option_coordinator.errors import OptionError
from option_coordinator.event_driven import OptionEnvironment
from option_coordinator.policy_file import OptionPolicy
from option_coordinator.roll_out import Drawing, Episode, RollOut, play_episodes
from option_coordinator.tasks import DISCOUNT, OptionTask, load_option_task, make_environment
from option_coordinator.tasks.water_filling import Sight
from option_coordinator.training.checkpoint import load_checkpoint, save_checkpoint
from option_coordinator.training.heads import as_numpy
from option_coordinator.training.learner import Learner
from option_coordinator.training.mac_dqn import MacDqn
from option_coordinator.training.mappo import Mappo
from option_coordinator.training.methods import METHODS, Method

_EVALUATION_SEED = 1_000_000
_MAC_DQN_BATCH = 30
"""Low-level samples between two updates (published)."""


@dataclass(frozen=True)
class OptionRun:
    """What is learnt: everything about it, and nothing that cannot be sent to another process.

    Attributes:
        task_name: of the task, or its file.
        method_name: one of `METHODS`.
        seed: of everything random.
        sight: what Water Filling's robots see.
    """

    task_name: str
    method_name: str
    seed: int
    sight: Sight = "features"

    @property
    def name(self) -> str:
        """Its name, which is that of its folder too."""
        seen = "" if self.sight == "features" else f"-{self.sight}"
        return f"{self.task.name}-{self.method_name}{seen}-s{self.seed}"

    @cached_property
    def task(self) -> OptionTask:
        """The task."""
        return load_option_task(self.task_name)

    @property
    def method(self) -> Method:
        """The method.

        Raises:
            OptionError: there is no such method.
        """
        try:
            return METHODS[self.method_name]
        except KeyError:
            raise OptionError(f"no method '{self.method_name}': there are {', '.join(METHODS)}") from None

    @property
    def description(self) -> dict[str, Any]:
        """What results and policy say about it."""
        return {
            "task": self.task.name,
            "task_digest": task_digest(self.task),
            "method": self.method_name,
            "seed": self.seed,
            "sight": self.sight,
            "level": self.method.level,
            "synchronisation": self.method.synchronisation,
        }

    @property
    def batch(self) -> int:
        """Low-level samples between two updates."""
        return self.task.batch_samples if self.method.learner == "mappo" else _MAC_DQN_BATCH

    def environment(self) -> OptionEnvironment:
        """Return its environment."""
        method = self.method
        return make_environment(self.task_name, method.synchronisation, DISCOUNT, method.level, self.sight)

    def learner(self) -> Learner:
        """Return the untrained learner."""
        torch.manual_seed(self.seed)
        agents = self.environment().agents
        if self.method.learner == "mac_dqn":
            return MacDqn(agents, DISCOUNT)
        return Mappo(agents, self.method.head, self.method.partial)

    def policy(self, learner: Learner, figures: dict[str, Any]) -> OptionPolicy:
        """Return what was learnt, to be saved."""
        return OptionPolicy(
            agents=self.environment().agents,
            head=self.method.head,
            partial=self.method.partial,
            tensors=as_numpy(learner.network),
            greedy=learner.greedy,
            manifest={**self.description, **figures},
        )


@dataclass(frozen=True)
class RunOptions:
    """How runs go.

    Attributes:
        folder: where each has a folder of its own.
        iterations: how many.
        samples: low-level samples of an iteration.
        evaluations: episodes after each iteration.
        final_evaluations: episodes after the last one.
    """

    folder: Path
    iterations: int = 25
    samples: int = 2000
    evaluations: int = 10
    final_evaluations: int = 50


Report = Callable[[OptionRun, int, float | str], None]


class _Iteration(NamedTuple):
    """What an iteration took, the episodes that ended in it, and figures of its last update."""

    samples: int
    episodes: list[Episode]
    figures: dict[str, float]


def option_runs(task_name: str, methods: Sequence[str], seeds: int, sight: Sight = "features") -> list[OptionRun]:
    """Return all runs of a task, those that matter most first."""
    ordered = sorted(methods, key=list(METHODS).index)
    return [OptionRun(task_name, method, seed, sight) for method in ordered for seed in range(seeds)]


def train_one(run: OptionRun, options: RunOptions, report: Report = lambda *_: None) -> dict[str, Any]:
    """Learn, or go on where an earlier call was cut off; a finished run is read, never computed again.

    The folder of the run then holds result.json (what is returned) and policy.safetensors (an `OptionPolicy`).

    Args:
        run: what is learnt.
        options: how.
        report: called after each iteration.

    Returns:
        description, `curve` (for each iteration: samples, what the episodes of learning and those of the evaluation
        amount to, see `summary`, figures of the last update, seconds) and `final`, the summary of the last evaluation.

    Raises:
        CtrlRlError: the run asks for what is not there, or its folder holds another run.
    """
    finished = result_file(options.folder, run)
    if finished.is_file():
        result: dict[str, Any] = json.loads(finished.read_text(encoding="utf-8"))
        _check_same(finished, result["run"], _terms(run, options))
        return result
    torch.set_num_threads(1)
    learner = run.learner()
    curve = _learn(run, options, learner, report)
    final = summary(evaluate(run, learner, options.final_evaluations, 2 * _EVALUATION_SEED))
    run.policy(learner, {"final": final}).save(finished.with_name("policy.safetensors"))
    result = {"run": _terms(run, options), "curve": curve, "final": final}
    write_whole(finished, json.dumps(result) + "\n")
    finished.with_name("checkpoint.safetensors").unlink(missing_ok=True)
    return result


def _learn(run: OptionRun, options: RunOptions, learner: Learner, report: Report) -> list[dict[str, Any]]:
    checkpoint = options.folder / run.name / "checkpoint.safetensors"
    checkpoint.parent.mkdir(parents=True, exist_ok=True)
    curve: list[dict[str, Any]] = []
    if checkpoint.is_file():
        progress = load_checkpoint(checkpoint, learner)
        _check_same(checkpoint, progress["run"], _terms(run, options))
        curve = progress["curve"]
    while len(curve) < options.iterations:
        begin = time.perf_counter()
        done, taken = len(curve), int(curve[-1]["samples"]) if curve else 0
        part = (done / options.iterations, (done + 1) / options.iterations)
        iteration = _iterate(run, learner, done, max(1, (done + 1) * options.samples - taken), part)
        tested = summary(evaluate(run, learner, options.evaluations, _EVALUATION_SEED))
        curve.append(
            {
                "samples": taken + iteration.samples,
                "learning": summary(iteration.episodes),
                "evaluation": tested,
                "update": iteration.figures,
                "seconds": round(time.perf_counter() - begin, 2),
            }
        )
        save_checkpoint(checkpoint, learner, {"run": _terms(run, options), "curve": curve})
        report(run, len(curve), f"return {tested['return']:.0f}" if tested else "")
    return curve


def _iterate(run: OptionRun, learner: Learner, number: int, samples: int, part: tuple[float, float]) -> _Iteration:
    """Learn from so many samples of fresh episodes, in batches of about the same size, during a part of the run."""
    generator = np.random.default_rng((run.seed, number))
    torch.manual_seed(int(generator.integers(2**31)))
    roll_out = RollOut(run.environment(), generator)
    figures: dict[str, float] = {}
    for left in range(max(1, round(samples / run.batch)), 0, -1):
        progress = part[0] + (part[1] - part[0]) * roll_out.samples / samples
        wanted = max(1, (samples - roll_out.samples) // left)
        figures = learner.learn(roll_out.collect(learner.behaviour(progress), wanted), generator)
    return _Iteration(roll_out.samples, roll_out.finished, figures)


def evaluate(run: OptionRun, learner: Learner, episodes: int, seed: int) -> list[Episode]:
    """Return episodes from the seeds `seed`, `seed` + 1 and so on, of the policy as it acts at the end of the run.

    It draws, as in learning. The most likely options alone may go round in circles where little is observed.
    """
    chooser = Drawing(learner.behaviour(1.0), np.random.default_rng(seed))
    return list(play_episodes(run.environment(), chooser, range(seed, seed + episodes)))


def summary(episodes: Sequence[Episode]) -> dict[str, float]:
    """Return means over episodes; nothing for no episodes.

    They are `return`, `steps`, `decisions`, `option_reward` (the thesis's metric), `terminated`, what the task says.
    """
    if not episodes:
        return {}
    columns: dict[str, list[float]] = {
        "return": [episode.returned for episode in episodes],
        "steps": [episode.steps for episode in episodes],
        "decisions": [episode.decisions for episode in episodes],
        "option_reward": [episode.mean_option_reward for episode in episodes],
        "terminated": [episode.terminated for episode in episodes],
    }
    columns |= {name: [e.figures[name] for e in episodes] for name in episodes[0].figures if name not in columns}
    return {name: float(np.mean(column)) for name, column in columns.items()}


def _terms(run: OptionRun, options: RunOptions) -> dict[str, Any]:
    """Return what must be the same for a run to go on, or to be taken as it is."""
    return {**run.description, "iterations": options.iterations, "samples": options.samples}


def _check_same(file: Path, before: dict[str, Any], now: dict[str, Any]) -> None:
    for name, value in now.items():
        if before.get(name) != value:
            raise OptionError(
                f"{file}: was made with {name} {before.get(name)}, now it is {value}: use another folder, or delete it"
            )
