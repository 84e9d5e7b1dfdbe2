"""The command `ros2 run oc_baseline_node oc`: computes the optimal control values of a task, step by step.

oc extract car_navigation                       the optimal control problem, and the reasons for it
oc solve car_navigation --output one.png        one trajectory
oc data car_navigation --output runs/car        hundreds of trajectories, in parallel; resumable
oc fit runs/car --output runs/car.safetensors   V_oc as a network, and optionally as a grid
oc map runs/car.safetensors --output map.png    its heat map
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from ctrl_rl_core.command import (
    NotNegative,
    OptionalFileToWrite,
    Positive,
    checked,
    checked_list,
    finite_number,
    make_command,
    name_and_value,
)
from ctrl_rl_core.tasks import require
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, load_navigation_task, write_results
from oc_baseline_node.errors import OcError
from oc_baseline_node.problems.extraction import extract
from oc_baseline_node.problems.problem import Form, OptimalControlProblem, formulate
from oc_baseline_node.problems.start_states import draw_start
from oc_baseline_node.value_data.dataset import DataSettings, load_data, read_description
from oc_baseline_node.value_data.report import remarks, report, start_set, value_rows
from oc_baseline_node.values.value_file import find_value, load_value, save_value

_SUMMARY = "From a task to its optimal control values: extract the problem, make value data, fit V_oc, draw it."


def _state(text: str) -> NDArray[np.float64]:
    try:
        return np.array([float(part) for part in text.split(",")])
    except ValueError:
        raise ValueError(f"'{text}' must be numbers with commas between") from None


def _setting(text: str) -> tuple[str, float]:
    name, value = name_and_value(text)
    return name, finite_number(value)


def _distance(text: str) -> float:
    value = finite_number(text)
    if value < 0.0:
        raise ValueError(f"is {value:g}: give metres, at least 0")
    return value


def _discount(text: str) -> float:
    value = finite_number(text)
    if not 0.0 < value <= 1.0:
        raise ValueError(f"must lie in (0, 1], not {value:g}")
    return value


_Task = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TASK")]
_Clearance = Annotated[float | None, checked(_distance, "METRES")]
_Settings = Annotated[tuple[tuple[str, float], ...], checked_list(_setting, "NAME=VALUE")]


@dataclass(frozen=True)
class Extract:
    """Show the optimal control problem of a task, and the rejected models."""

    task: _Task
    """Name of a task of the suite (car_navigation, curved_corridor ...), or its file."""
    form: Form = "free_speed"
    """free_speed: speed is a control; free_time: constant speed, free time step; letter: Eq. 3.16 as printed, with
    constant speed and fixed horizon, infeasible from most starts."""
    clearance: _Clearance = None
    """Minimum distance d_min from obstacles [m]; by default the task's, but more than the body's radius."""


@dataclass(frozen=True)
class Solve(Extract):
    """Solve one trajectory; exit with 1 and the solver's reason if there is none."""

    start: Annotated[NDArray[np.float64] | None, checked(_state, "X,Y,...")] = None
    """Start state x_0, such as 0,-3.5,1.57; by default random."""
    seed: NotNegative = 0
    """Seed of the random start."""
    solver: Literal["ipopt", "fatrop"] | None = None
    """The only solver to try; by default fatrop, then ipopt."""
    output: Path | None = None
    """Figure to write; none by default."""


@dataclass(frozen=True, kw_only=True)
class Data(Extract):
    """Solve many trajectories from random starts; an interrupted call can be repeated to continue."""

    output: Path
    """Folder of the data, with one file per chunk of trajectories."""
    trajectories: Positive | None = None
    """Number of solved trajectories; by default the task's."""
    seed: NotNegative = 0
    """Seed of the random starts."""
    workers: Positive = os.cpu_count() or 1
    """Number of worker processes."""
    ray: str | None = None
    """Address of a Ray cluster, auto for the one on this machine; local processes by default."""


@dataclass(frozen=True)
class Fit:
    """Fit V_oc, a 64 x 64 tanh network, to value data."""

    data: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DATA")]
    """Folder written by 'oc data'."""
    output: Path
    """Network to write (.safetensors)."""
    task: str | None = None
    """Task file, if the task is not one of the suite's."""
    grid: Path | None = None
    """Value grid to write in addition (.safetensors)."""
    discount: Annotated[float | None, checked(_discount, "FRACTION")] = None
    """Discount per policy step; the task's by default."""
    whole_horizon: bool = False
    """Sum Eq. 3.13 beyond arrival, to the end of the horizon."""
    epochs: Positive = 200
    """Number of passes over the data."""
    seed: NotNegative = 0
    """Seed of the split, the weights and the order of the samples."""
    overwrite: bool = False
    """Replace existing files."""
    results: OptionalFileToWrite = None
    """JSON file for the results of data and fit."""


@dataclass(frozen=True)
class Map:
    """Draw the heat map of a value function (thesis Fig. 3.11)."""

    value: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="VALUE")]
    """File of a network or a value grid, or the task of a shipped network."""
    output: Path
    """Figure to write."""
    task: str | None = None
    """Task file, if the task is not one of the suite's."""
    at: _Settings = ()
    """Values of the other state components; 0 by default."""


_Command: Any = (
    Annotated[Extract, tyro.conf.subcommand("extract")]
    | Annotated[Solve, tyro.conf.subcommand("solve")]
    | Annotated[Data, tyro.conf.subcommand("data")]
    | Annotated[Fit, tyro.conf.subcommand("fit")]
    | Annotated[Map, tyro.conf.subcommand("map")]
)


def _terms(options: Extract) -> tuple[NavigationTask, Form, float | None]:
    """Return the task, form and clearance of the problem to formulate."""
    task = load_navigation_task(options.task)
    require("oc_baseline_node oc data", task)
    return task, options.form, options.clearance


def _extract(options: Extract) -> int:
    print(extract(*_terms(options)).report())
    return 0


def _solve(options: Solve) -> int:
    from oc_baseline_node.mpc.mpc import Mpc

    problem = formulate(*_terms(options))
    mpc = Mpc(problem) if options.solver is None else Mpc(problem, (options.solver,))
    start = draw_start(problem, np.random.default_rng(options.seed)) if options.start is None else options.start
    trajectory = mpc.solve(start)
    print(*remarks(problem, mpc.rounded), sep="", end="")
    print(f"start         {_named(problem, start)}")
    print(f"answer        {trajectory.reason}, {trajectory.iterations} iterations, {trajectory.cpu_seconds:.3f} CPU s")
    if not trajectory.solved:
        print("trajectory    none")
        return 1
    print(f"end           {_named(problem, trajectory.states[-1])}")
    print(f"cost          {trajectory.cost:.6g} (Eq. 3.16), {problem.horizon} steps of {trajectory.time_step:.3g} s")
    least = float(problem.margin(trajectory.states).min())
    print(f"clearance     at least {problem.clearance + least:.3f} m from the real obstacles and walls")
    if options.output is not None:
        from oc_baseline_node.plots import draw_trajectories

        draw_trajectories(problem.task, [problem.task_states(trajectory.states)], options.output)
        print(f"picture       {options.output}")
    return 0


def _data(options: Data) -> int:
    from oc_baseline_node.mpc.mpc import Mpc
    from oc_baseline_node.value_data.workers import make_data

    problem = formulate(*_terms(options))
    assert problem.task.optimal_control is not None  # guaranteed by the problem
    wanted = problem.task.optimal_control.trajectories if options.trajectories is None else options.trajectories
    settings = DataSettings(wanted, seed=options.seed)
    print(*remarks(problem, Mpc(problem).rounded), sep="", end="")
    data, wall, cpu = make_data(problem, settings, options.output, options.workers, ray=options.ray)
    print(report(data))
    print(start_set(problem, options.seed))
    with_what = f"{options.workers} processes" if options.ray is None else f"the Ray cluster {options.ray}"
    print(f"this run      {wall:.1f} s with {with_what}, {cpu:.1f} CPU s in all")
    print(f"data          {options.output}")
    return 0


def _fit(options: Fit) -> int:
    from oc_baseline_node.value_data.value_fit import FitSettings, fit

    for path in (options.output, options.grid):
        if path is not None and path.exists() and not options.overwrite:
            raise OcError(f"{path} exists: give another name, or --overwrite")
    there = read_description(options.data)
    task = load_navigation_task(options.task or there["task"])
    problem = formulate(task, there["form"], there["clearance"])
    settings = FitSettings(options.discount, options.whole_horizon, epochs=options.epochs, seed=options.seed)
    data = load_data(options.data, problem)
    value = fit(problem, data, settings)
    save_value(value, options.output, options.overwrite)
    unseen, seen = value.manifest["held_out"], value.manifest["fitted"]
    print(
        f"held out      error {unseen['mae']:.3g} mean, {unseen['p95']:.3g} p95, {unseen['rmse']:.3g} rms\n"
        f"              over {unseen['trajectories']} trajectories; as many others would give a mean from "
        f"{unseen['mae_low']:.3g} to {unseen['mae_high']:.3g} (95 %)"
    )
    print(f"values        spread by {unseen['std_of_values']:.3g} (their standard deviation)")
    print(f"fitted        error {seen['mae']:.3g} mean, {seen['p95']:.3g} p95, {seen['rmse']:.3g} root mean square")
    print(f"network       {options.output}")
    if options.grid is not None:
        value.grids[0].save(options.grid, overwrite=options.overwrite)
        print(f"grid          {options.grid}, {' x '.join(map(str, value.grids[0].values.shape))}")
    if options.results is not None:
        seeds = [int(there["seed"])]
        write_results(options.results, f"optimal control values, {task.name}", seeds, value_rows(data, value))
        print(f"figures       {options.results}")
    return 0


def _map(options: Map) -> int:
    from oc_baseline_node.plots import draw_heat_map

    value = load_value(find_value(options.value))
    task = load_navigation_task(options.task or value.task)
    values = draw_heat_map(value, task, options.output, dict(options.at))
    free = values[np.isfinite(values)]
    print(f"values        {free.min():.4g} .. {free.max():.4g}")
    print(f"picture       {options.output}")
    return 0


def _named(problem: OptimalControlProblem, state: NDArray[np.float64]) -> str:
    names = problem.system.state_names
    return ", ".join(f"{name} = {x:.3g}" for name, x in zip(names, state, strict=False))


_WORK: dict[type, Callable[[Any], int]] = {Extract: _extract, Solve: _solve, Data: _data, Fit: _fit, Map: _map}
main = make_command("oc", _Command, lambda options: _WORK[type(options)](options), _SUMMARY)
