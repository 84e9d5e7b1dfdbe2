"""The command `compile`: compiles the nodes' kernels before a robot has to wait for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from math import pi
from pathlib import Path

import numpy as np
from ament_index_python.packages import get_package_prefix
from ctrl_rl_core.help_pages import keep_page
from ctrl_rl_core.robots import DEFAULT_ROBOT

from ctrl_rl_core import (
    Axis,
    Interval,
    Quantity,
    Region,
    System,
    ValueGrid,
    entry,
    find_robot,
    map_in_processes,
    parse_options,
    run_command,
)


@dataclass(frozen=True)
class CompileOptions:
    """Compile the nodes' kernels and cache the pages of --help, so that the first start is as quick as any other.

    The code is stored beside the sources, or in the user's cache folder if they are read-only. Existing code is not
    compiled again. Without this command each node compiles its kernels at its first start.
    """


def compile_kernels() -> int:
    """Compile the nodes' kernels."""
    parse_options("compile", CompileOptions)
    return run_command("compile", _compile, failure=2)


def _compile() -> int:
    for name in map_in_processes(_call, list(KERNELS)):
        print(f"compiled   {name}")
    doors = [each for each in entry_points(group="console_scripts") if each.module == entry.__name__]
    print(f"help       {sum(map_in_processes(_keep_page, doors))} pages")
    return 0


def _keep_page(door: EntryPoint) -> bool:
    """Cache the help page of an executable; return whether there is one."""
    name = door.dist.name.replace("-", "_") if door.dist else ""
    executable = Path(get_package_prefix(name)) / "lib" / name / door.name
    keep_page(executable, door.load())
    return executable.exists()


def _call(name: str) -> str:
    KERNELS[name]()
    return name


def _filter() -> None:
    from ctrl_rl_safety.filter import warm_up

    from ctrl_rl_safety import ROBOTS, FilterOptions

    warm_up(ROBOTS[DEFAULT_ROBOT], FilterOptions())


def _flight_guard() -> None:
    from ctrl_rl_core import load_navigation_task
    from ctrl_rl_safety import FlightGuard, quadrotor_of

    FlightGuard(quadrotor_of(load_navigation_task("quad_ttr")), ()).warm_up()


def _solver() -> None:
    from ttr_reward_node import problem_from_task, solve

    solve(problem_from_task("car_ttr", counts=(11, 11, 8), inflation=0.5), max_sweeps=2, certify=False)


def _solver_of_nodes() -> None:
    """Compile the sweep for systems whose f depends on every state."""
    from ttr_reward_node import TimeToReachProblem, solve

    pendulum = System(
        name="pendulum",
        states=(Quantity("angle", "rad", -pi, pi, periodic=True), Quantity("rate", "rad/s")),
        controls=(Quantity("push", "1", -1.0, 1.0),),
        disturbances=(Quantity("d_angle", "rad/s", 0.0, 0.0), Quantity("d_rate", "rad/s^2", 0.0, 0.0)),
        parameters={},
        equations=lambda m, _p: lambda x, u, d: (x[1] + d[0], m.sin(x[0]) + u[0] + d[1]),
    )
    axes = (Axis("angle", "rad", -pi, pi, 16, periodic=True), Axis("rate", "rad/s", -3.0, 3.0, 15))
    target = Region({"angle": Interval(-0.8, 0.8), "rate": Interval(-0.8, 0.8)})
    solve(TimeToReachProblem(pendulum, axes, target), max_sweeps=2, certify=False)


def _navigator() -> None:
    from ctrl_rl_navigation.driving import warm_up
    from ctrl_rl_navigation.robot import limits_of

    warm_up(limits_of(find_robot(DEFAULT_ROBOT)))


def _values(dimensions: int) -> None:
    axes = tuple(Axis(f"x{k}", "1", 0.0, 1.0, 2) for k in range(dimensions))
    values = np.zeros((2,) * dimensions, np.float32)
    grid = ValueGrid(values, axes, "time_to_reach", "none", "0" * 64, "none", 0.0)
    middle = np.full(dimensions, 0.5)
    grid.at(middle)
    grid.value(middle)
    grid.value_and_gradient(middle)
    grid.value_and_gradient_at(middle)


KERNELS: dict[str, Callable[[], None]] = {
    "safety filter": _filter,
    "flight guard": _flight_guard,
    "time to reach": _solver,
    "time to reach, node by node": _solver_of_nodes,
    "navigator": _navigator,
    "values of cars": partial(_values, 3),
    "values of quadrotors": partial(_values, 4),
}
"""Functions that compile the nodes' kernels, the slowest first."""
