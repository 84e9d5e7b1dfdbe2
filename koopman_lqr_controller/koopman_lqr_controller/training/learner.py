"""One run of task-oriented learning (thesis Algorithm 2), from one seed; may be cut off at any time.

    result = learn_one(LearningRun("cartpole_swingup", seed=0), Options(Path("runs/mine"), iterations=36, samples=500))

It goes in chunks of actions. Each begins a fresh episode and draws its random numbers from the seed and its own number,
so that a run that goes on from its last checkpoint ends exactly as if it had not been cut off.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from ctrl_rl_core.whole_file import write_whole
from ctrl_rl_training.checkpoint import read_checkpoint, restore, tensors_of, write_checkpoint
from ctrl_rl_training.run_folder import Options, Report, check_same, result_file
from numpy.typing import NDArray

from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.latent_policy import LatentPolicy
from koopman_lqr_controller.policy_file import load_policy, save_policy
from koopman_lqr_controller.roll_outs import Lived, evaluate, interaction, mean_return, outcomes
from koopman_lqr_controller.training.agent import Agent, Sight
from koopman_lqr_controller.training.problems import AnyEnvironment, Problem, find_problem
from koopman_lqr_controller.training.replay import Replay

LEARNT_FILE = "learnt.json"
"""What `learn_one` returns, in the folder of a run; its result.json comes when all is done, see `finishing`."""
POLICY_FILE = "policy.safetensors"
"""What is learnt, in the folder of a run."""
_BEST_FILE, _CHECKPOINT_FILE = "best.safetensors", "checkpoint.safetensors"
_EVALUATION_SEED, _FINAL_SEED = 1_000_000, 2_000_000


@dataclass(frozen=True)
class LearningRun:
    """What is learnt: everything about it, and nothing that cannot be sent to another process.

    Attributes:
        problem_name: one of `PROBLEMS`.
        seed: of everything random.
        changes: of the problem's `Settings`, by name.
        device: of the networks: "cpu", whose runs can be repeated exactly, or "cuda".
        command: that made it, for the policy file.
        consolidation: episodes of each round of what follows, see `finishing`.
    """

    problem_name: str
    seed: int
    changes: tuple[tuple[str, Any], ...] = ()
    device: str = "cpu"
    command: str = ""
    consolidation: int = 30

    @property
    def name(self) -> str:
        """Its name, which is that of its folder too."""
        changes = "".join(f"-{name}_{value}" for name, value in self.changes)
        return f"{self.problem_name}{changes}-s{self.seed}"

    @property
    def problem(self) -> Problem:
        """The problem with its settings.

        Raises:
            KoopmanError: there is no such problem or setting.
        """
        return find_problem(self.problem_name).with_settings(**dict(self.changes))

    @property
    def description(self) -> dict[str, Any]:
        """What must be the same for a run to go on, as JSON."""
        problem = self.problem
        return {
            "task": problem.name,
            "task_digest": problem.digest,
            "seed": self.seed,
            "device": self.device,
            "settings": problem.settings.as_json(),
        }


def learn_one(run: LearningRun, options: Options, report: Report = lambda *_: None, /) -> dict[str, Any]:
    """Learn, or go on where an earlier call was cut off; a finished run is read, never computed again.

    The folder of the run then holds learnt.json (what is returned) and policy.safetensors, the policy that was best
    in the evaluations after each chunk; on the way also best.safetensors and checkpoint.safetensors.

    Args:
        run: what is learnt.
        options: iterations is the largest number of chunks, samples the actions of one.
        report: called after each chunk with the best return so far.

    Returns:
        `run` (its description), `curve` (for each chunk: actions and episodes so far, steps of the system, returns of
        the actor and of its average, what it took to evaluate them, seconds and those of the CPU), `best` (actions,
        evaluated return, which of both), `interaction` (episodes and actions that were learnt from, and those that the
        best was chosen by) and, of fresh episodes, `returns` and `outcomes`.

    Raises:
        CtrlRlError: the run asks for what is not there, or its checkpoint cannot be used.
    """
    finished = result_file(options.folder, run).with_name(LEARNT_FILE)
    if finished.is_file():
        result: dict[str, Any] = json.loads(finished.read_text(encoding="utf-8"))
        check_same(finished, result["run"], terms(run, options))
        return result
    torch.set_num_threads(1)
    if run.device != "cpu" and not torch.cuda.is_available():
        raise KoopmanError(f"device {run.device}: torch sees none; use cpu")
    environments = [run.problem.make(learning) for learning in (True, False)]
    try:
        return _Learning(run, options, *environments).finish(report)
    finally:
        for environment in environments:
            environment.close()


class _Learning:
    """A run under way."""

    def __init__(self, run: LearningRun, options: Options, environment: AnyEnvironment, tested: AnyEnvironment) -> None:
        self._run, self._options = run, options
        self._environment, self._tested = environment, tested
        self._folder = result_file(options.folder, run).parent
        self._folder.mkdir(parents=True, exist_ok=True)
        problem, seen = run.problem, environment.observation_space
        sight = Sight(
            shape=seen.shape,
            controls=environment.action_space.shape[0],
            middle=np.array(problem.middle, np.float32),
            unit=np.array(problem.unit, np.float32),
            goal=None if problem.goal is None else np.array(problem.goal, np.float32),
        )
        self._agent = Agent(sight, problem.settings, run.seed, run.device)
        capacity = min(problem.settings.replay, 2 * options.iterations * options.samples)
        self._replay = Replay(capacity, sight.shape, sight.controls, seen.dtype.type)
        self._actions = self._episodes = 0
        self._curve: list[dict[str, Any]] = []
        self._best: dict[str, Any] = {"return": -float("inf"), "actions": 0}
        self._resume()

    def finish(self, report: Report) -> dict[str, Any]:
        """Learn what is left and write everything, the result last."""
        while not self._over:
            begin, cpu = time.perf_counter(), time.process_time()
            self._live()
            point = {
                "actions": self._actions,
                "episodes": self._episodes,
                "steps": self._actions * self._run.problem.repeat,
                **self._evaluate(),
            }
            seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - cpu
            self._curve.append({**point, "seconds": round(seconds, 2), "cpu_seconds": round(cpu_seconds, 2)})
            self._save()
            report(self._run, len(self._curve), self._best["return"])
        policy = load_policy(self._folder / _BEST_FILE)
        assert isinstance(policy, LatentPolicy)
        fresh = evaluate(policy.controller, self._tested, self._options.final_evaluations, _FINAL_SEED)
        last = {"returns": [episode.total for episode in fresh], "outcomes": outcomes(fresh)}
        manifest = {**policy.manifest, **last}
        save_policy(replace(policy, manifest=manifest), self._folder / POLICY_FILE, overwrite=True)
        tested = [point["evaluated"] for point in self._curve]
        result = {
            "run": terms(self._run, self._options),
            "curve": self._curve,
            "best": self._best,
            "interaction": {
                "learning": {"episodes": self._episodes, "actions": self._actions},
                "choosing": {name: sum(each[name] for each in tested) for name in ("episodes", "actions")},
            },
            **last,
        }
        write_whole(self._folder / LEARNT_FILE, json.dumps(result) + "\n")
        for name in (_CHECKPOINT_FILE, _BEST_FILE):
            (self._folder / name).unlink(missing_ok=True)
        return result

    @property
    def _over(self) -> bool:
        """Whether the chunks, the episodes, or the patience are used up."""
        problem, chunks = self._run.problem, self._curve
        since_best = sum(point["actions"] > self._best["actions"] for point in chunks)
        return (
            len(chunks) >= self._options.iterations
            or bool(problem.episodes and self._episodes >= problem.episodes)
            or bool(problem.patience and since_best >= problem.patience)
        )

    def _live(self) -> None:
        """Act and learn for one chunk."""
        number, settings, budget = len(self._curve), self._run.problem.settings, self._run.problem.episodes
        random = np.random.default_rng((self._run.seed, number))
        generator = torch.Generator().manual_seed(int(random.integers(2**63)))
        environment, agent, shape = self._environment, self._agent, self._environment.action_space.shape
        x, _ = environment.reset(seed=int(random.integers(2**31)))
        for step in range(self._options.samples):
            learning = self._actions >= settings.first_steps
            u = agent.act(x, generator) if learning else random.uniform(-1.0, 1.0, shape).astype(np.float32)
            after, paid, terminated, truncated, _ = environment.step(u)
            self._replay.add(x, u, float(paid), bool(terminated))
            x, self._actions = after, self._actions + 1
            ended = terminated or truncated or step == self._options.samples - 1
            if ended:
                self._replay.end_episode(after)
                self._episodes += 1
                x, _ = environment.reset(seed=int(random.integers(2**31)))
            if learning and self._actions % settings.update_every == 0:
                agent.update(self._replay.draw(settings.batch, random), generator)
            if ended and self._episodes == budget:
                return

    def _evaluate(self) -> dict[str, Any]:
        """Evaluate the actor and its average on seeds of their own; keep the better one if it is the best so far."""
        out: dict[str, Any] = {}
        lived: list[Lived] = []
        for name, actor in (("averaged", self._agent.averaged), ("actor", self._agent.actor)):
            controller = actor.deploy()
            episodes = evaluate(controller, self._tested, self._options.evaluations, _EVALUATION_SEED)
            lived += episodes
            out[name] = mean_return(episodes)
            if out[name] > self._best["return"]:
                self._best = {"return": out[name], "actions": self._actions, "which": name}
                wiring = getattr(self._environment, "wiring", None)
                manifest = {**self._run.description, "method": _METHOD, "command": self._run.command, **self._best}
                policy = LatentPolicy(controller, self._environment.dt, wiring, manifest)
                save_policy(policy, self._folder / _BEST_FILE, overwrite=True)
        return {**out, "evaluated": interaction(lived)}

    def _save(self) -> None:
        agent = self._agent
        tensors = tensors_of({"agent": agent}, agent.optimizers)
        tensors |= {f"replay.{name}": array for name, array in self._replay.arrays().items()}
        header = {
            "run": terms(self._run, self._options),
            "curve": self._curve,
            "best": self._best,
            "updates": agent.updates,
        }
        write_checkpoint(self._folder / _CHECKPOINT_FILE, tensors, header)

    def _resume(self) -> None:
        file = self._folder / _CHECKPOINT_FILE
        if not file.is_file():
            return

        def take(header: Mapping[str, Any], tensors: Mapping[str, NDArray[Any]]) -> None:
            check_same(file, header["run"], terms(self._run, self._options))
            restore(tensors, {"agent": self._agent}, self._agent.optimizers)
            prefix = "replay."
            self._replay.restore({n.removeprefix(prefix): a for n, a in tensors.items() if n.startswith(prefix)})
            self._curve, self._best = header["curve"], header["best"]
            self._agent.updates = header["updates"]
            self._actions, self._episodes = (self._curve[-1][name] for name in ("actions", "episodes"))

        read_checkpoint(file, take)


_METHOD = "task-oriented Koopman control with contrastive encoder (thesis 4.2)"


def terms(run: LearningRun, options: Options) -> dict[str, Any]:
    """Return what must be the same for a run to go on, or to be taken as it is."""
    return {
        **run.description,
        "actions_per_chunk": options.samples,
        "chunks": options.iterations,
        "evaluations": options.evaluations,
        "final_evaluations": options.final_evaluations,
    }
