"""The benchmark tasks: environments, suitable settings, and the thesis's returns. Imports no torch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from ctrl_rl_core.tasks import require

from ctrl_rl_core import load_navigation_task, task_names
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.environments.environment_tasks import environment_task, make_suite
from koopman_lqr_controller.training.environments.task import AnyEnvironment, BenchmarkTask
from koopman_lqr_controller.training.settings import Settings


def find_task(name: str) -> BenchmarkTask:
    """Return a task by name: one of the table, that of an environment, or the corridor of a task or its .yaml file.

    Raises:
        KoopmanError: The problem does not exist, or the environment cannot be learnt.
        TaskError: The file is not a task, or the task has no corridor.
    """
    if name in BENCHMARK_TASKS:
        return BENCHMARK_TASKS[name]
    if (environment := environment_task(name)) is not None:
        return environment
    if not name.endswith(".yaml") and name not in task_names():
        raise KoopmanError(
            f"no task '{name}': there are {', '.join(BENCHMARK_TASKS)}, or a .yaml file with a corridor; --env takes "
            "Gymnasium's environments and the control suite's tasks"
        )
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


def _corridor(task: str) -> Callable[[bool], AnyEnvironment]:
    def make(learning: bool) -> AnyEnvironment:
        from koopman_lqr_controller.training.environments.corridor import Corridor

        return Corridor(learning, task=task)

    return make


_ALL = (
    BenchmarkTask(
        name="cartpole_swingup",
        about="DeepMind control suite: swing a pole up and hold it, from position and velocity",
        make=make_suite("cartpole", "swingup", 8),
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
        make=make_suite("cartpole", "swingup", 8, 72),
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
        make=make_suite("cheetah", "run", 4),
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
        make=make_suite("cheetah", "run", 2),
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
