"""`ros2 run oc_baseline_node oc`: from a task to its optimal control values, step by step.

oc extract car_navigation                       what the optimal control problem is, and why
oc solve car_navigation --output one.png        one trajectory
oc data car_navigation --output runs/car        hundreds of them, in parallel; run it again after a kill
oc fit runs/car --output runs/car.safetensors   V_oc as a network, and as a grid where asked
oc map runs/car.safetensors --output map.png    its heat map
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from ctrl_rl_core.command import check_least, file_to_write, run_command
from ctrl_rl_core.io.results import write_results
from ctrl_rl_core.tasks.task import NavigationTask, load_navigation_task
from ctrl_rl_core.values.value_function import ValueFunction
from numpy.typing import NDArray

from oc_baseline_node.errors import OcError
from oc_baseline_node.problems.extraction import extract
from oc_baseline_node.problems.problem import FORMS, Form, OptimalControlProblem, formulate
from oc_baseline_node.problems.start_states import draw_episode_start, draw_start
from oc_baseline_node.value_data.dataset import DataSettings, ValueData, load_data, read_description
from oc_baseline_node.value_data.results import value_rows
from oc_baseline_node.values.value_file import find_value, load_value, save_value

_EPISODES = 10
"""Starts of an episode that `oc data` tries."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    work: Callable[[argparse.Namespace], int] = options.work
    return run_command("oc", lambda: work(options))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="oc", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    command = _command(commands, "extract", _extract, "say which problem follows from a task, and which models do not")
    _add_problem(command)
    command = _command(commands, "solve", _solve, "solve one trajectory; exit code 1 and the solver's reason if none")
    _add_problem(command)
    command.add_argument("--start", type=_numbers, help="x_0, e.g. 0,-3.5,1.57 (default: a random one)")
    command.add_argument("--seed", type=int, default=0, help="of the random start (default %(default)s)")
    command.add_argument("--solver", choices=("ipopt", "fatrop"), help="one only (default: fatrop, else ipopt)")
    command.add_argument("--output", type=Path, help="picture to write")
    command = _command(commands, "data", _data, "solve many trajectories from random starts, goes on where it ended")
    _add_problem(command)
    command.add_argument("--output", type=Path, required=True, help="folder, one file a chunk of trajectories")
    command.add_argument("--trajectories", type=int, help="how many solved ones (default: the task's)")
    command.add_argument("--seed", type=int, default=0, help="of the starts (default %(default)s)")
    command.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default %(default)s)")
    command.add_argument("--ray", metavar="ADDRESS", help="Ray cluster that solves instead, auto for this machine's")
    command = _command(commands, "fit", _fit, "fit V_oc to value data: a 64 x 64 tanh network")
    command.add_argument("data", type=Path, help="folder that 'oc data' made")
    command.add_argument("--task", help="its task file, where the task is not one of the suite's")
    command.add_argument("--output", type=Path, required=True, help="network to write (.safetensors)")
    command.add_argument("--grid", type=Path, help="value grid to write as well (.safetensors)")
    command.add_argument("--discount", type=float, help="of a policy's step (default: the task's)")
    command.add_argument("--whole-horizon", action="store_true", help="sum Eq. 3.13 on after arrival")
    command.add_argument("--epochs", type=int, default=200, help="passes over the data (default %(default)s)")
    command.add_argument("--seed", type=int, default=0, help="of split, weights, order (default %(default)s)")
    command.add_argument("--overwrite", action="store_true", help="replace existing files")
    command.add_argument("--results", type=file_to_write, help="JSON file for the figures of data and fit")
    command = _command(commands, "map", _map, "draw a value's heat map (thesis Fig. 3.11)")
    command.add_argument("value", type=Path, help="file of a network or a value grid, or the task of a shipped one")
    command.add_argument("--task", help="its task file, where the task is not one of the suite's")
    command.add_argument("--output", type=Path, required=True, help="picture to write")
    command.add_argument("--at", nargs="*", default=[], metavar="NAME=VALUE", help="other components (default 0)")
    return parser


def _command(
    commands: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    work: Callable[[argparse.Namespace], int],
    text: str,
) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=text, description=text)
    parser.set_defaults(work=work)
    return parser


def _add_problem(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("task", help="a task of the suite (car_navigation, curved_corridor ...) or its file")
    parser.add_argument(
        "--form",
        choices=FORMS,
        default=FORMS[0],
        help="free_speed: speed is a control; free_time: constant speed, free time step; letter: Eq. 3.16 as printed, "
        "constant speed and fixed horizon, infeasible from most starts (default %(default)s)",
    )
    parser.add_argument("--clearance", type=float, help="d_min [m] (default: the task's, more than the body's radius)")


def _terms(options: argparse.Namespace) -> tuple[NavigationTask, Form, float | None]:
    """Return what a problem is made from."""
    if options.clearance is not None and not 0.0 <= options.clearance < np.inf:
        raise OcError(f"--clearance is {options.clearance:g}: give metres, zero or more")
    return load_navigation_task(options.task), options.form, options.clearance


def _extract(options: argparse.Namespace) -> int:
    print(extract(*_terms(options)).report())
    return 0


def _solve(options: argparse.Namespace) -> int:
    from oc_baseline_node.mpc.mpc import Mpc

    check_least(options, seed=0)
    problem = formulate(*_terms(options))
    mpc = Mpc(problem) if options.solver is None else Mpc(problem, (options.solver,))
    start = draw_start(problem, np.random.default_rng(options.seed)) if options.start is None else options.start
    trajectory = mpc.solve(start)
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


def _data(options: argparse.Namespace) -> int:
    from oc_baseline_node.value_data.workers import make_data

    check_least(options, trajectories=1, seed=0, workers=1)
    problem = formulate(*_terms(options))
    assert problem.task.optimal_control is not None  # without it there is no problem
    wanted = problem.task.optimal_control.trajectories if options.trajectories is None else options.trajectories
    settings = DataSettings(wanted, seed=options.seed)
    data, wall, cpu = make_data(problem, settings, options.output, options.workers, ray=options.ray)
    print(_report(data))
    print(_start_set(problem, options.seed))
    with_what = f"{options.workers} processes" if options.ray is None else f"the Ray cluster {options.ray}"
    print(f"this run      {wall:.1f} s with {with_what}, {cpu:.1f} CPU s in all")
    print(f"data          {options.output}")
    return 0


def _start_set(problem: OptimalControlProblem, seed: int) -> str:
    """Say from how many starts of an episode there is a trajectory: the data are drawn from the whole map."""
    from oc_baseline_node.mpc.mpc import Mpc

    mpc, random = Mpc(problem), np.random.default_rng(seed)
    found = [mpc.solve(draw_episode_start(problem, random)) for _ in range(_EPISODES)]
    lacking = sorted({each.reason for each in found if not each.solved})
    lines = [
        f"start set     {sum(each.solved for each in found)} of {_EPISODES} starts of an episode have a trajectory"
    ]
    return "\n".join(lines + [f"              {reason}" for reason in lacking])


def _report(data: ValueData) -> str:
    solved, tried = len(data.states), len(data.states) + len(data.unsolved)
    doomed = int(data.doomed.sum())
    rest = [reason for reason, hopeless in zip(data.reasons, data.doomed, strict=True) if not hopeless]
    lines = [
        f"trajectories  {solved} of {data.states.shape[1] - 1} steps",
        f"success       {data.success_rate:.1%} of {tried} random starts",
        f"no trajectory {doomed} starts cannot keep clear for a second, goal or not; without them "
        f"{data.success_rate_of_viable:.1%}",
        *(f"              {rest.count(reason)} times {reason}" for reason in sorted(set(rest))),
        f"CPU seconds   {data.cpu_seconds.mean():.3f} mean, {np.percentile(data.cpu_seconds, 95):.3f} p95 "
        f"per trajectory; {(data.cpu_seconds.sum() + data.wasted_seconds.sum()) / solved:.3f} with the starts in vain",
    ]
    return "\n".join(lines)


def _fit(options: argparse.Namespace) -> int:
    from oc_baseline_node.value_data.value_fit import FitSettings, fit

    check_least(options, epochs=1, seed=0)
    if options.discount is not None and not 0.0 < options.discount <= 1.0:
        raise OcError(f"--discount must lie in (0, 1], not {options.discount:g}")
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
        f"              over {unseen['trajectories']} trajectories; as many others would give a mean of "
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


def _map(options: argparse.Namespace) -> int:
    from oc_baseline_node.plots import draw_heat_map

    value = load_value(find_value(options.value))
    values = draw_heat_map(value, _task_of(value, options.task), options.output, dict(map(_setting, options.at)))
    free = values[np.isfinite(values)]
    print(f"values        {free.min():.4g} .. {free.max():.4g}")
    print(f"picture       {options.output}")
    return 0


def _task_of(value: ValueFunction, given: str | None) -> NavigationTask:
    return load_navigation_task(given or value.task)


def _named(problem: OptimalControlProblem, state: NDArray[np.float64]) -> str:
    names = problem.system.state_names
    return ", ".join(f"{name} = {x:.3g}" for name, x in zip(names, state, strict=False))


def _numbers(text: str) -> NDArray[np.float64]:
    try:
        return np.array([float(part) for part in text.split(",")])
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' must be numbers with commas between") from None


def _setting(text: str) -> tuple[str, float]:
    name, _, number = text.partition("=")
    try:
        return name, float(number)
    except ValueError:
        raise OcError(f"--at: '{text}' must be NAME=VALUE with a number") from None
