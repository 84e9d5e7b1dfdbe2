"""The benchmark tasks: environments, suitable settings, and the thesis's returns. Imports no torch."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ctrl_rl_core.tasks import require

from ctrl_rl_core import load_navigation_task, task_digest, task_names
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.settings import Settings

AnyEnvironment = Any
"""A gymnasium.Env; the package is imported only when one is created."""


@dataclass(frozen=True)
class BenchmarkTask:
    """A task to learn.

    Attributes:
        name: Name of the task.
        about: Description in one line.
        make: Creates an environment for training (True) or evaluation (False).
        settings: Training settings.
        repeat: Number of simulation steps per action.
        chunk: Number of actions between two evaluations; whole episodes if they have a fixed length.
        chunks: Default number of chunks.
        evaluations: Number of episodes per evaluation.
        chunk_episodes: Number of episodes after which a chunk ends early; 0 for no limit.
        episodes: Maximum number of training episodes, including those that end with a chunk; 0 for no limit.
        patience: Number of chunks without a new best after which training ends; 0 for no limit.
        goal: Observation of the goal; None for z_ref = 0.
        middle: Value of the observation that maps to 0 in the encoder.
        unit: Distance from `middle` that maps to 1.
        thesis: Return reported in the thesis, or None.
        task: Name or file of a task with a corridor; empty for tasks of other kinds.
        version: Version of the environment's observations and rewards; increased with each change of them.
    """

    name: str
    about: str
    make: Callable[[bool], AnyEnvironment]
    settings: Settings
    repeat: int
    chunk: int
    chunks: int
    evaluations: int = 5
    chunk_episodes: int = 0
    episodes: int = 0
    patience: int = 0
    goal: tuple[float, ...] | None = None
    middle: float = 0.0
    unit: float = 1.0
    thesis: float | None = None
    task: str = ""
    version: int = 1

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the task's definition, independent of the training duration."""
        task = task_digest(load_navigation_task(self.task)) if self.task else None
        parts = [Path(self.name).stem, self.version, self.repeat, self.goal, self.middle, self.unit, task]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()

    def with_settings(self, **changes: Any) -> BenchmarkTask:
        """Return the task with other settings.

        Raises:
            KoopmanError: A setting is unknown or out of range.
        """
        try:
            settings = replace(self.settings, **changes)
        except TypeError:
            unknown = set(changes) - set(self.settings.as_json())
            known = ", ".join(self.settings.as_json())
            raise KoopmanError(f"no setting {', '.join(sorted(unknown))}: there are {known}") from None
        if bool(settings.crop) != bool(self.settings.crop):
            must = "positive, this task shows pictures" if self.settings.crop else "0, this task shows none"
            raise KoopmanError(f"crop is {settings.crop}: must be {must}")
        return replace(self, settings=settings)


def find_task(name: str) -> BenchmarkTask:
    """Return a problem by name, or the corridor problem of a task or its .yaml file.

    Raises:
        KoopmanError: The problem does not exist.
        TaskError: The file is not a task, or the task has no corridor.
    """
    if name in BENCHMARK_TASKS:
        return BENCHMARK_TASKS[name]
    if not name.endswith(".yaml") and name not in task_names():
        raise KoopmanError(f"no task '{name}': there are {', '.join(BENCHMARK_TASKS)}, or a .yaml file with a corridor")
    require("koopman_lqr_controller train", load_navigation_task(name))
    about = "the corridor of a task file"
    return replace(BENCHMARK_TASKS["curved_corridor"], name=name, about=about, make=_corridor(name), task=name)


def task_of_manifest(manifest: Mapping[str, Any]) -> BenchmarkTask:
    """Return the problem named in a policy's manifest.

    Raises:
        KoopmanError: The problem does not exist, or has changed since the policy was made.
        TaskError: The task's file is invalid.
    """
    name = str(manifest.get("task"))
    problem = find_task(name)
    if manifest.get("task_digest", problem.digest) != problem.digest:
        raise KoopmanError(f"task {name} has changed since the policy was made: learn it again")
    return problem


def _suite(domain: str, task: str, repeat: int, pixels: int = 0) -> Callable[[bool], AnyEnvironment]:
    def make(_: bool) -> AnyEnvironment:
        from koopman_lqr_controller.training.environments.control_suite import ControlSuite

        return ControlSuite(domain, task, repeat, pixels)

    return make


def _corridor(task: str) -> Callable[[bool], AnyEnvironment]:
    def make(learning: bool) -> AnyEnvironment:
        from koopman_lqr_controller.training.environments.corridor import Corridor

        return Corridor(learning, task=task)

    return make


_ALL = (
    BenchmarkTask(
        name="cartpole_swingup",
        about="DeepMind control suite: swing a pole up and hold it, from position and velocity",
        make=_suite("cartpole", "swingup", 8),
        settings=Settings(bfloat16="all"),
        repeat=8,
        chunk=500,
        chunks=48,
        patience=16,
        goal=(0.0, 1.0, 0.0, 0.0, 0.0),
        thesis=846.88,
    ),
    BenchmarkTask(
        name="cartpole_swingup_pixels",
        about="the same from three grey pictures",
        make=_suite("cartpole", "swingup", 8, 72),
        settings=Settings(depth=4, crop=64, batch=128, learning_rate=1e-3, bfloat16="all"),
        repeat=8,
        chunk=1000,
        chunks=40,
        patience=15,
        middle=127.5,
        unit=127.5,
        thesis=873.0,
    ),
    BenchmarkTask(
        name="cheetah_run",
        about="DeepMind control suite: a planar cheetah runs",
        make=_suite("cheetah", "run", 4),
        settings=Settings(learning_rate=3e-4, discount=0.98, critic_rate=0.02, bfloat16="all"),
        repeat=4,
        chunk=2500,
        chunks=35,
        patience=15,
        evaluations=6,
        thesis=464.0,
    ),
    BenchmarkTask(
        name="cheetah_run_fine",
        about="the same with actions of two simulated steps, as TD-MPC2, SimbaV2 and MR.Q take it",
        make=_suite("cheetah", "run", 2),
        settings=Settings(learning_rate=3e-4, critic_rate=0.02, bfloat16="all"),
        repeat=2,
        chunk=5000,
        chunks=35,
        patience=15,
        evaluations=6,
    ),
    BenchmarkTask(
        name="curved_corridor",
        about="a simulated TurtleBot3 drives along a narrow curved path, from lidar and odometry",
        make=_corridor("curved_corridor"),
        task="curved_corridor",
        settings=Settings(latent=32, hidden=128, batch=128, first_steps=200, discount=0.97, updates=2),
        repeat=1,
        chunk=1400,
        chunks=20,
        evaluations=3,
        chunk_episodes=2,
        episodes=40,
        version=3,
    ),
)
BENCHMARK_TASKS = {problem.name: problem for problem in _ALL}
"""Tasks by name. The corridor is trained on 40 episodes, as in the thesis, of at most 700 steps."""
