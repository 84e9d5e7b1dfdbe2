"""The commands `solve`, `check`, `slices` and `relabel`: time-to-reach functions, what they keep, rewards for bags."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ctrl_rl_core.command import check_least, run_command
from ctrl_rl_core.tasks.task import load_navigation_task
from ctrl_rl_core.values.value_grid import ValueGrid
from tqdm import tqdm

from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.problem import TimeToReachProblem, problem_from_task
from ttr_reward_node.rewards.relabel import relabel
from ttr_reward_node.rewards.reward_evaluator import RewardEvaluator
from ttr_reward_node.solvers.decomposition import DECOMPOSITIONS, find_decomposition, join, split
from ttr_reward_node.solvers.memory import gigabytes
from ttr_reward_node.solvers.solution import Solution
from ttr_reward_node.solvers.solver import METHODS, check_reached, memory_needed, solve
from ttr_reward_node.values.decomposed_value import DecomposedValue
from ttr_reward_node.values.value_file import load_value
from ttr_reward_node.verification.check import advice, as_line, check_value


def solve_value(arguments: Sequence[str] | None = None) -> int:
    """Compute the time to reach of a task and write it to a file."""
    parser = _parser("solve", "Compute the shortest time to a task's goal from every state (thesis Eq. 3.4).")
    parser.add_argument("--task", required=True, help="task name or .yaml file")
    parser.add_argument("--output", type=Path, help="file to write (default <task>.safetensors)")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing file")
    parser.add_argument(
        "--method",
        choices=tuple(METHODS),
        default="semi_lagrangian",
        help="lax_friedrichs is the thesis's, less exact and slower (default %(default)s)",
    )
    parser.add_argument("--count", nargs="+", default=(), metavar="STATE=N", help="nodes, in place of the task's")
    parser.add_argument(
        "--disturbance",
        nargs="+",
        default=(),
        metavar="D_STATE=LOW:HIGH",
        help="bounded disturbances that work against the robot, e.g. d_x=-0.1:0.1",
    )
    inflation = parser.add_mutually_exclusive_group()
    inflation.add_argument("--inflation", type=float, default=0.0, help="widen obstacles by this much [m]")
    inflation.add_argument("--robot-size", action="store_true", help="widen obstacles by the robot's radius")
    parser.add_argument("--width", type=float, help="of the task's corridor [m] (default: the task's)")
    parser.add_argument(
        "--decomposition",
        choices=sorted({name for choices in DECOMPOSITIONS.values() for name in choices}),
        help="split the system; the maximum of the parts is a lower bound (4d+4d is the thesis's for the quadrotor)",
    )
    parser.add_argument("--tolerance", type=float, help="change of a sweep at which it stops [s]")
    parser.add_argument("--max-sweeps", type=int, help="after how many it gives up")
    options = parser.parse_args(arguments)
    return run_command("solve", lambda: _solve(options))


def check(arguments: Sequence[str] | None = None) -> int:
    """Drive by a time-to-reach function and compare the time taken with the time promised."""
    parser = _parser("check", "Drive by a time-to-reach function, greedily, from random states: does it keep its word?")
    parser.add_argument("file", type=Path, help="the function (.safetensors), of a car")
    parser.add_argument("--task", help="task to drive in (default: the one it was made for)")
    parser.add_argument("--width", type=float, help="of the task's corridor [m] (default: the task's)")
    parser.add_argument("--starts", type=int, default=1000, help="how many (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the random starts (default %(default)s)")
    parser.add_argument("--at-least", type=float, help="exit with 1 if fewer arrive, e.g. 0.95 (default: never)")
    options = parser.parse_args(arguments)
    return run_command("check", lambda: _check(options))


def slices(arguments: Sequence[str] | None = None) -> int:
    """Draw slices through a time-to-reach function, as thesis Fig. 3.1 does."""
    parser = _parser("slices", "Draw slices through a time-to-reach function, as thesis Fig. 3.1 does.")
    parser.add_argument("file", type=Path, help="the function (.safetensors)")
    parser.add_argument("--task", help="task to draw with it (default: the one it was made for)")
    parser.add_argument("--output", type=Path, help="picture to write (default: beside the file)")
    cut = "where to cut, e.g. theta=0,1.57 (default: as Fig. 3.1)"
    parser.add_argument("--at", nargs="+", default=(), metavar="STATE=VALUE,...", help=cut)
    options = parser.parse_args(arguments)
    return run_command("slices", lambda: _slices(options))


def relabel_bag(arguments: Sequence[str] | None = None) -> int:
    """Add rewards to a recorded bag."""
    parser = _parser("relabel", "Write a bag again with the topics reward and time_to_reach, for offline learning.")
    parser.add_argument("bag", type=Path, help="with odometry in the frame of the time-to-reach function")
    parser.add_argument("output", type=Path, help="the new bag")
    parser.add_argument("--grid", type=Path, required=True, help="time-to-reach function (.safetensors)")
    parser.add_argument("--task", help="task that says what is paid (default: the one that the function was made for)")
    parser.add_argument("--width", type=float, help="of the task's corridor [m] (default: the task's)")
    parser.add_argument("--robot", default="", help="namespace of the topics (default: none)")
    parser.add_argument("--frame", default="map", help="of the function's positions (default %(default)s)")
    parser.add_argument("--replace", action="store_true", help="leave out rewards that the bag has already")
    options = parser.parse_args(arguments)
    return run_command("relabel", lambda: _relabel(options))


def _parser(program: str, description: str) -> argparse.ArgumentParser:
    return argparse.ArgumentParser(prog=program, description=description)


def _problem(options: argparse.Namespace) -> TimeToReachProblem:
    task = load_navigation_task(options.task)
    return problem_from_task(
        task,
        counts={name: _whole(value) for name, value in map(_pair, options.count)},
        inflation=task.robot.radius if options.robot_size else options.inflation,
        width=options.width,
        disturbances={name: _bounds(value) for name, value in map(_pair, options.disturbance)},
    )


def _solve(options: argparse.Namespace) -> int:
    problem = _problem(options)
    output = options.output or Path(f"{problem.name}.safetensors")
    if output.exists() and not options.overwrite:
        raise TimeToReachError(f"{output} exists: name another file with --output, or add --overwrite")
    if not output.parent.is_dir():
        raise TimeToReachError(f"{output}: there is no folder {output.parent}: make it, or name another with --output")
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
    return 0 if all(solution.converged for solution in solutions) else 1


def _solve_one(problem: TimeToReachProblem, options: argparse.Namespace) -> Solution:
    size = gigabytes(memory_needed(problem, options.method))
    print(f"problem    {problem.system.name}, {' x '.join(map(str, problem.counts))} nodes, at most {size}", flush=True)
    with tqdm(desc="solving", unit=" sweeps", disable=None) as bar:

        def show(_sweep: int, change: float) -> None:
            bar.set_postfix_str(f"largest change {change:.2g} s", refresh=False)
            bar.update()

        limits = {"tolerance": options.tolerance, "max_sweeps": options.max_sweeps}
        solution = solve(problem, options.method, **limits, progress=show)
    state = "converged" if solution.converged else "NOT converged (allow more with --max-sweeps)"
    print(f"solved     {state} after {solution.sweeps} sweeps, {solution.cpu_seconds:.2f} s CPU")
    print(f"residual   {solution.residual:.2g} s, the largest change of the last sweep")
    print(f"reachable  {100 * solution.reachable:.1f} % of the nodes", flush=True)
    return solution


def _check(options: argparse.Namespace) -> int:
    check_least(options, starts=1)
    value = load_value(options.file)
    task = load_navigation_task(options.task or value.task)
    found, problem = check_value(value, task, width=options.width, states=options.starts, seed=options.seed)
    print(as_line(found))
    if cause := advice(found, problem, task.robot.radius):
        print(cause)
    return 0 if options.at_least is None or found["reached"] >= options.at_least else 1


def _slices(options: argparse.Namespace) -> int:
    from ttr_reward_node.plots.value_slices import draw_slices  # matplotlib is not for robots

    function = load_value(options.file)
    at = {name: [_number(part) for part in values.split(",")] for name, values in map(_pair, options.at)}
    output = options.output or options.file.with_suffix(".png")
    draw_slices(function, load_navigation_task(options.task or function.task), output, at)
    print(f"picture    {output}")
    return 0


def _relabel(options: argparse.Namespace) -> int:
    function = load_value(options.grid)
    label = RewardEvaluator(load_navigation_task(options.task or function.task), function, options.width)
    if not label.up_to_date:
        print(f"relabel: {options.grid} is of another version of its task: solve it again", file=sys.stderr)
    count = relabel(
        options.bag,
        options.output,
        function,
        label,
        robot=options.robot,
        frame=options.frame,
        replace=options.replace,
        progress=True,
    )
    print(f"labelled   {count} odometry messages")
    print(f"bag        {options.output}")
    return 0


def _pair(text: str) -> tuple[str, str]:
    name, separator, value = text.partition("=")
    if not (name and separator and value):
        raise TimeToReachError(f"'{text}' must be NAME=VALUE")
    return name, value


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise TimeToReachError(f"'{text}' is not a number") from None


def _whole(text: str) -> int:
    if not text.isdecimal():
        raise TimeToReachError(f"'{text}' is not a whole number")
    return int(text)


def _bounds(text: str) -> tuple[float, float]:
    low, separator, high = text.partition(":")
    if not separator:
        raise TimeToReachError(f"'{text}' must be LOW:HIGH")
    return _number(low), _number(high)
