"""Mismatch between model and simulator, and its effect on MPC (thesis Table 3.5, Fig. 3.17)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Episode, NavigationTask, Step, System, drive
from oc_baseline_node.mpc.mpc import Mpc
from oc_baseline_node.mpc.receding_horizon import RecedingHorizon
from oc_baseline_node.problems.problem import formulate
from sim_bridge import NavigationEnv

Array = NDArray[np.float64]
STEPS = (1, 5, 10)
"""Numbers of control steps compared in Table 3.5."""


def with_extra_mass(task: NavigationTask, per_cent: float) -> NavigationTask:
    """Return a quadrotor task with additional mass and inertia, e.g. a battery missing from the model.

    Raises:
        ValueError: The task's system has neither, or they would not be positive.
    """
    factor = 1.0 + per_cent / 100.0
    return task.model_copy(update={"system": task.system.scaled({"m": factor, "I_yy": factor})})


def transition_errors(
    task: NavigationTask, roll_outs: int = 10, seed: int = 0, plant: NavigationTask | None = None
) -> Array:
    """Return the position errors (roll_outs, len(STEPS)) [m] between model and simulator, see Table 3.5.

    Both start in the same random start of the task and receive the same random commands, a new one in each control
    step; so does every other plant. NaN if the episode has ended before.

    Args:
        task: Task with the predicting model.
        roll_outs: Number of roll-outs.
        seed: Seed of the starts and commands.
        plant: Simulated task; the same one by default.
    """
    problem = formulate(task)
    environment = NavigationEnv(plant or task)
    errors = np.full((roll_outs, len(STEPS)), np.nan)
    try:
        for roll_out in range(roll_outs):
            random = np.random.default_rng((seed, roll_out))
            _, info = environment.reset(seed=seed + roll_out)
            x = info["state"]
            for step in range(1, max(STEPS) + 1):
                action = random.uniform(-1.0, 1.0, 2).astype(np.float32)
                x = predict(problem.system, x, command(task, action), task.episode.time_step)
                _, _, terminated, _, info = environment.step(action)
                if terminated:  # the motion after a crash is irrelevant for the model
                    break
                if step in STEPS:
                    apart = (x - info["state"])[problem.positions]
                    errors[roll_out, STEPS.index(step)] = np.hypot(*apart)
    finally:
        environment.close()
    return errors


def predict(system: System, x: Array, u: Array, duration: float, parts: int = 10) -> Array:
    """Return the model's state (n,) after `duration` [s] under a constant control (m,)."""
    for _ in range(parts):
        x = system.step(x, u, dt=duration / parts)
    return x


def command(task: NavigationTask, action: Sequence[float] | NDArray[np.float32]) -> Array:
    """Convert an action in [-1, 1] (m,) to a command (m,)."""
    low, high = np.array(list(task.robot.commands.values())).T
    return low + 0.5 * (np.asarray(action, dtype=float) + 1.0) * (high - low)


def action_of(task: NavigationTask, control: Array) -> NDArray[np.float32]:
    """Return the action in [-1, 1] (m,) nearest to a control (m,)."""
    low, high = np.array(list(task.robot.commands.values())).T
    return np.clip(2.0 * (control - low) / (high - low) - 1.0, -1.0, 1.0).astype(np.float32)


def _with_time_step(task: NavigationTask, time_step: float) -> NavigationTask:
    """Return the task with MPC's time step and episodes of equal duration."""
    episode = task.episode
    steps = round(episode.steps * episode.time_step / time_step)
    changed = episode.model_copy(update={"time_step": time_step, "steps": steps})
    return task.model_copy(update={"episode": changed})


def run_mpc_episodes(
    task: NavigationTask, episodes: int = 10, seed: int = 0, progress: Callable[[], object] = lambda: None
) -> list[tuple[Episode[Any], float]]:
    """Run receding-horizon MPC in the simulator as in Fig. 3.17; it plans with the model only.

    Args:
        task: Task with the arena, the rewards and the problem.
        episodes: Number of episodes, with the seeds `seed`, `seed` + 1, etc.
        seed: Seed of the first episode.
        progress: Called after each step.

    Returns:
        Each episode, and the fraction of its steps in which the solver found a trajectory.
    """
    problem = formulate(task)
    mpc = Mpc(problem)
    environment = NavigationEnv(_with_time_step(task, problem.time_step))
    try:
        return [_drive(environment, each, mpc, progress) for each in range(seed, seed + episodes)]
    finally:
        environment.close()


class _MpcDriver:
    """MPC on the true state, as a driver of the environment."""

    def __init__(self, mpc: Mpc, progress: Callable[[], object]) -> None:
        self._controller, self._task, self._progress = RecedingHorizon(mpc), mpc.problem.task, progress
        self.state: Array = np.empty(0)
        self.solved: list[bool] = []

    def look(self, step: Step[Any]) -> None:
        """Store the true state."""
        self.state = step.info["state"]

    def command(self, _: object) -> Any:
        u = self._controller.control(self.state)
        self.solved.append(self._controller.solved)
        self._progress()
        return action_of(self._task, u)


def _drive(
    environment: NavigationEnv, seed: int, mpc: Mpc, progress: Callable[[], object]
) -> tuple[Episode[Any], float]:
    driver = _MpcDriver(mpc, progress)
    (episode,) = drive(environment, driver, seeds=(seed,), keep=True, watch=driver.look)
    return episode, float(np.mean(driver.solved))
