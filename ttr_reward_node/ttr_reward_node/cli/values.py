"""The commands `solve`, `check`, `slices` and `relabel`: compute, verify and plot values; add rewards to bags."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import tyro
from ctrl_rl_bags.datasets import check_task, print_note
from ctrl_rl_core.command import (
    FiniteNumber,
    NotNegative,
    Positive,
    checked_list,
    finite_number,
    make_command,
    name_and_value,
    one_of,
)
from ctrl_rl_core.tasks import require, with_grid
from tqdm import tqdm

from ctrl_rl_bags import bag_info
from ctrl_rl_core import ValueGrid, load_navigation_task, task_digest
from ttr_reward_node.certificates.certificate import Certificate
from ttr_reward_node.cli.safe_sets import solve_and_save
from ttr_reward_node.errors import DoubtfulValueWarning, TimeToReachError
from ttr_reward_node.problems.from_task import problem_from_task
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.rewards.relabel import relabel
from ttr_reward_node.rewards.rewards import RewardEvaluator
from ttr_reward_node.solvers.decomposition import DECOMPOSITIONS, find_decomposition, join, split
from ttr_reward_node.solvers.devices import CPU
from ttr_reward_node.solvers.solution import Solution, gigabytes
from ttr_reward_node.solvers.solver import check_reached, memory_needed, solve
from ttr_reward_node.values.decomposed_value import DecomposedValue
from ttr_reward_node.values.value_file import load_value
from ttr_reward_node.verification.check import advice, as_line, check_value


def _count(text: str) -> tuple[str, int]:
    name, value = name_and_value(text)
    if not value.isdecimal():
        raise ValueError(f"'{value}' is not a whole number")
    return name, int(value)


def _disturbance(text: str) -> tuple[str, tuple[float, float]]:
    name, value = name_and_value(text)
    low, separator, high = value.partition(":")
    if not separator:
        raise ValueError(f"'{value}' must be LOW:HIGH")
    return name, (finite_number(low), finite_number(high))


def _cut(text: str) -> tuple[str, tuple[float, ...]]:
    name, values = name_and_value(text)
    return name, tuple(finite_number(part) for part in values.split(","))


_Decomposition = Annotated[str, one_of(sorted({name for choices in DECOMPOSITIONS.values() for name in choices}))]
_Counts = Annotated[tuple[tuple[str, int], ...], checked_list(_count, "STATE=N")]
_ControlCounts = Annotated[tuple[tuple[str, int], ...], checked_list(_count, "CONTROL=N")]
_Disturbances = Annotated[tuple[tuple[str, tuple[float, float]], ...], checked_list(_disturbance, "D_STATE=LOW:HIGH")]
_Cuts = Annotated[tuple[tuple[str, tuple[float, ...]], ...], checked_list(_cut, "STATE=VALUE,...")]
_File = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
_Bag = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="BAG")]
_Output = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUTPUT")]


@dataclass(frozen=True)
class Solve:
    """Compute the shortest time to a task's goal from every state (thesis Eq. 3.4), or the safe states."""

    task: str
    """Name or .yaml file of the task."""
    kind: Literal["time_to_reach", "avoid", "reach_avoid"] = "time_to_reach"
    """Value to compute: the time to the goal [s]; or the distance that can be kept from all obstacles [m], for ever
    (avoid) or until the goal is reached (reach_avoid). States with a value of at least 0 m are safe."""
    horizon: FiniteNumber | None = None
    """Time horizon of avoid and reach_avoid [s] (default: infinite)."""
    output: Path | None = None
    """File to write (default: <task>.safetensors)."""
    overwrite: bool = False
    """Replace an existing file."""
    method: Literal["semi_lagrangian", "lax_friedrichs"] = "semi_lagrangian"
    """Solver; lax_friedrichs is the method of the thesis, less accurate and slower."""
    count: _Counts = ()
    """Number of nodes on the axis of a state (default: the task's)."""
    disturbance: _Disturbances = ()
    """Bounds of adversarial disturbances, e.g. d_x=-0.1:0.1; d_x=0.5:0.5 is a steady current."""
    controls: _ControlCounts = ()
    """Number of samples of a control between its bounds (default: as many as the equations need)."""
    inflation: FiniteNumber | None = None
    """Inflation of obstacles [m] (default: 0, or the robot's radius with --robot-size)."""
    robot_size: bool = False
    """Inflate obstacles by the robot's radius."""
    width: FiniteNumber | None = None
    """Width of the task's corridor [m] (default: the task's)."""
    decomposition: _Decomposition | None = None
    """Decomposition of the system; the maximum over its parts is a lower bound (4d+4d is the thesis's for the
    quadrotor)."""
    tolerance: FiniteNumber | None = None
    """Largest change in the last sweep [s] (default: a fraction of the time to cross a cell)."""
    max_sweeps: Positive | None = None
    """Maximum number of sweeps (default: the method's limit)."""
    finer: Positive | None = None
    """Number of cells into which each grid cell is split along each axis while solving (default: up to 4 on two axes,
    else 1)."""
    strict: bool = False
    """Exit with code 1 if the solution is doubtful."""
    device: str = "cpu"
    """Device to solve on: cpu, or cuda for a GPU (cuda:1 for a second one), which needs NVIDIA Warp."""


@dataclass(frozen=True)
class Check:
    """Drive greedily by a time-to-reach function from random states, and compare executed and predicted times."""

    file: _File
    """Time-to-reach function of a car (.safetensors)."""
    task: str | None = None
    """Task to drive in (default: the function's task)."""
    width: FiniteNumber | None = None
    """Width of the task's corridor [m] (default: the task's)."""
    starts: Positive = 1000
    """Number of random start states."""
    seed: NotNegative = 0
    """Random seed for the start states."""
    at_least: FiniteNumber | None = None
    """Minimum fraction of starts that must arrive, e.g. 0.95; exit with code 1 if fewer do."""


@dataclass(frozen=True)
class Slices:
    """Plot slices through a time-to-reach function, as in thesis Fig. 3.1, or through a safety value."""

    file: _File
    """Time-to-reach function or safety value (.safetensors)."""
    task: str | None = None
    """Task whose goal and obstacles to draw (default: the function's task)."""
    output: Path | None = None
    """Figure to write (default: FILE with the suffix .png)."""
    at: _Cuts = ()
    """Values of other states to slice at, e.g. theta=0,1.57 (default: those of Fig. 3.1)."""


@dataclass(frozen=True)
class Relabel:
    """Copy a bag and add the topics reward and time_to_reach, for offline learning."""

    bag: _Bag
    """Bag with odometry in the frame of the time-to-reach function."""
    output: _Output
    """Folder of the new bag."""
    grid: Path
    """Time-to-reach function (.safetensors)."""
    task: str | None = None
    """Task that defines the rewards (default: the function's task)."""
    width: FiniteNumber | None = None
    """Width of the task's corridor [m] (default: the task's)."""
    robot: str = ""
    """Namespace of the robot's topics; empty for none."""
    odometry: str = "odom"
    """Odometry topic, relative to the namespace unless it begins with /."""
    other_task: bool = False
    """Also accept a bag of another task or of another version of the task."""
    frame: str = "map"
    """Frame of the function's positions."""
    replace: bool = False
    """Replace rewards and values that the bag already contains."""


def _problem(options: Solve) -> TimeToReachProblem:
    if options.robot_size and options.inflation is not None:
        raise TimeToReachError("--inflation and --robot-size exclude each other: give one of them")
    if options.kind == "time_to_reach" and options.horizon is not None:
        raise TimeToReachError("--horizon is for --kind avoid and reach_avoid: leave it out")
    if options.kind != "time_to_reach" and (options.strict or options.finer):
        raise TimeToReachError(f"--strict and --finer are for times to reach: leave them out of {options.kind}")
    if options.kind != "time_to_reach" and (options.decomposition or options.method != "semi_lagrangian"):
        raise TimeToReachError(f"--decomposition and --method are for times to reach: leave them out of {options.kind}")
    task = load_navigation_task(options.task)
    require("ttr_reward_node solve", task)
    posed = with_grid(task)
    if posed is not task:
        print(f"grid       the task has none: {', '.join(f'{name} {axis.count}' for name, axis in posed.grid.items())}")
    problem = problem_from_task(
        posed,
        counts=dict(options.count),
        inflation=task.robot.radius if options.robot_size else options.inflation or 0.0,
        width=options.width,
        disturbances=dict(options.disturbance),
        control_counts=dict(options.controls),
    )
    return replace(problem, digest=task_digest(task))  # a grid chosen here does not change the task's identity


def _solve(options: Solve) -> int:
    problem = _problem(options)
    output = options.output or Path(f"{problem.name}.safetensors")
    if output.exists() and not options.overwrite:
        raise TimeToReachError(f"{output} exists: name another file with --output, or add --overwrite")
    if not output.parent.is_dir():
        raise TimeToReachError(f"{output}: there is no folder {output.parent}: make it, or name another with --output")
    if options.kind != "time_to_reach":
        if options.device != CPU:
            raise TimeToReachError(f"--kind {options.kind} runs on the CPU alone: leave --device out")
        converged = solve_and_save(
            problem,
            options.kind,
            output,
            horizon=options.horizon,
            tolerance=options.tolerance,
            max_steps=options.max_sweeps,
            overwrite=options.overwrite,
        )
        return 0 if converged else 1
    if options.decomposition is None:
        solutions = [_solve_one(problem, options)]
        value: ValueGrid | DecomposedValue = solutions[0].grid
    else:
        decomposition = find_decomposition(problem.system, options.decomposition)
        subsystems = split(problem, decomposition)
        solutions = [_solve_one(part.problem, options) for part in subsystems]
        value = join(decomposition, problem, subsystems, solutions)
    check_reached(problem, value)
    value.save(output, overwrite=options.overwrite)
    print(f"file       {output}")
    doubtful = options.strict and any(s.certificate is not None and s.certificate.doubts for s in solutions)
    return 0 if all(solution.converged for solution in solutions) and not doubtful else 1


def _solve_one(problem: TimeToReachProblem, options: Solve) -> Solution:
    size = gigabytes(memory_needed(problem, options.method, options.finer))
    print(f"problem    {problem.system.name}, {' x '.join(map(str, problem.counts))} nodes, at most {size}")
    with tqdm(desc="solving", unit=" sweeps", disable=None) as bar:

        def show(_sweep: int, change: float) -> None:
            bar.set_postfix_str(f"largest change {change:.2g} s", refresh=False)
            bar.update()

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DoubtfulValueWarning)  # printed below
            solution = solve(
                problem,
                options.method,
                tolerance=options.tolerance,
                max_sweeps=options.max_sweeps,
                progress=show,
                finer=options.finer,
                device=options.device,
            )
    state = "converged" if solution.converged else "NOT converged (allow more with --max-sweeps)"
    print(f"solved     {state} after {solution.sweeps} sweeps, {solution.cpu_seconds:.2f} s CPU")
    print(f"residual   {solution.residual:.2g} s, the largest change of the last sweep")
    print(f"reachable  {100 * solution.reachable:.1f} % of the nodes")
    _print_certificate(solution.certificate)
    return solution


def _print_certificate(certificate: Certificate | None) -> None:
    if certificate is None:
        return
    print(f"certified  {certificate.line}")
    if certificate.grid:
        print(f"grid       {certificate.grid}")
    for doubt in certificate.doubts:
        print(f"doubt      {doubt}")


def _check(options: Check) -> int:
    value = load_value(options.file)
    task = load_navigation_task(options.task or value.task)
    found, problem = check_value(value, task, width=options.width, states=options.starts, seed=options.seed)
    print(as_line(found))
    if cause := advice(found, problem, task.robot.radius):
        print(cause)
    for grid in value.grids:
        _print_certificate(Certificate.from_notes(grid.notes))
    return 0 if options.at_least is None or found["reached"] >= options.at_least else 1


def _slices(options: Slices) -> int:
    from ttr_reward_node.plots.value_slices import draw_slices  # keep matplotlib off robots

    function = load_value(options.file)
    output = options.output or options.file.with_suffix(".png")
    draw_slices(function, load_navigation_task(options.task or function.task), output, dict(options.at))
    print(f"picture    {output}")
    return 0


def _relabel(options: Relabel) -> int:
    function = load_value(options.grid)
    task = load_navigation_task(options.task or function.task)
    custom_data, note = bag_info(options.bag).custom_data, partial(print_note, "relabel")
    check_task(options.bag, custom_data, task.name, task_digest(task), allowed=options.other_task, tell=note)
    evaluator = RewardEvaluator(task, function, options.width)
    if not evaluator.up_to_date:
        print(f"relabel: {options.grid} belongs to another version of its task: solve the task again", file=sys.stderr)
    count = relabel(
        options.bag,
        options.output,
        function,
        evaluator,
        robot=options.robot,
        odometry=options.odometry,
        frame=options.frame,
        replace=options.replace,
        progress=True,
    )
    print(f"labelled   {count} odometry messages")
    print(f"bag        {options.output}")
    return 0


solve_value = make_command("solve", Solve, _solve)
check = make_command("check", Check, _check)
slices = make_command("slices", Slices, _slices)
relabel_bag = make_command("relabel", Relabel, _relabel)
