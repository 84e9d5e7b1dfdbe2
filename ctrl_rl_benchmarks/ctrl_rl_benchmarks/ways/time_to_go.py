"""MPC's time to go: the seconds that the trajectories which MPC finds take to the goal.

It is the thesis's V_oc (Eq. 3.13) of a task in which the goal pays 1 and nothing else pays: V = gamma^(t/dt) where a
trajectory takes t seconds, so that t follows from V.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from ctrl_rl_core.tasks.schema.optimal_control import OptimalControlSpec
from ctrl_rl_core.tasks.schema.parts import RewardSpec
from numpy.typing import NDArray
from oc_baseline_node.problems.problem import TIME_STEP_RANGE
from oc_baseline_node.values.mlp_value import MlpValue
from oc_baseline_node.values.value_file import load_network

from ctrl_rl_benchmarks.ways.methods import GAMMA
from ctrl_rl_core import NavigationTask, task_digest

Array = NDArray[np.float64]
TRAJECTORIES = 500
"""Solved trajectories that the time to go of a task is fitted to."""
_STEPS = 100
"""Steps of a trajectory."""
_LONGEST = "longest_time"


def mpc_task(task: NavigationTask) -> NavigationTask:
    """Return a task with the optimal control problem of its time to go, made by one rule for all tasks.

    The steps of a trajectory are equal and free, and the longest trajectory lasts an episode. The state cost does not
    grow and outweighs the controls' by far, so that trajectories are fast. A trap is no obstacle: the time to reach
    knows none either.
    """
    longest = task.episode.steps * task.episode.time_step
    spec = OptimalControlSpec.model_validate(
        {
            "horizon": _STEPS,
            "time_step": f"{longest / (_STEPS * TIME_STEP_RANGE[1])!r} s",
            "gamma": 1.0,
            "discount": GAMMA,
            "state_weight": 10.0,
            "control_weight": 0.1,
            "clearance": "0 m",
            "trajectories": TRAJECTORIES,
            "controls": {},
            "bounds": {},
        }
    )
    pays = RewardSpec(goal=1.0, collision=0.0)
    return task.model_copy(update={"optimal_control": spec, "rewards": pays, "trap": None})


def find_or_fit(
    task: NavigationTask, folder: Path, tell: Callable[[str], None] = lambda _: None, workers: int = 1
) -> Path:
    """Return the file of MPC's time to go of this version of a task, made now unless it is there.

    A call that is cut off keeps the trajectories that it has solved, in a folder beside the file.

    Args:
        task: Task in an arena.
        folder: Folder of the files.
        tell: Takes a line before the solver begins.
        workers: Processes that solve.

    Raises:
        OcError: MPC finds hardly any trajectory to the goal.
        LockError: Another call makes it.
    """
    posed = mpc_task(task)
    file = folder / f"{task.name}-{task_digest(posed)[:12]}-mpc.safetensors"
    if file.is_file():
        return file
    # CasADi is only needed here: whoever has the file learns without it.
    from oc_baseline_node import DataSettings, fit, formulate, make_data, save_value

    tell(f"solving    {task.name}, {TRAJECTORIES} trajectories by MPC")
    problem = formulate(posed, "free_time")
    data = make_data(problem, DataSettings(TRAJECTORIES), file.with_suffix(""), workers)[0]
    value = fit(problem, data)
    longest = float(data.time_steps.max()) * _STEPS
    save_value(replace(value, manifest={**value.manifest, _LONGEST: longest}), file)
    return file


class TimeToGo:
    """The time to go of a file of `find_or_fit`; a state outside its domain is looked up at the nearest one within.

    Attributes:
        longest: Time of the longest trajectory [s], at which longer times are cut off.
        digest: SHA-256 of the network.
    """

    def __init__(self, file: Path, task: NavigationTask) -> None:
        self._value: MlpValue = load_network(file)
        self.longest, self.digest = float(self._value.manifest[_LONGEST]), self._value.digest
        self._seconds = task.episode.time_step / np.log(GAMMA)

    def times(self, states: Array) -> Array:
        """Return the times (N,) from states (N, n) to the goal [s]; +inf in a collision and where V is not positive."""
        values = self._value.value(self._value.clipped(states))
        arrives = values > 0.0
        times = self._seconds * np.log(np.where(arrives, np.minimum(values, 1.0), 1.0))
        return np.where(arrives, np.minimum(times, self.longest), np.inf)
