"""Simulated episodes of a policy in a task, with or without the safety filter: the `drive` of package `ctrl_rl`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from ctrl_rl_core.policies import policy_of
from numpy.typing import NDArray

from ctrl_rl_core import (
    Actor,
    Driver,
    Episodes,
    Filter,
    NavigationTask,
    Policy,
    PolicyDriver,
    PolicyError,
    Sensors,
    find_policy,
    load_navigation_task,
    load_policy,
)
from ctrl_rl_core import drive as drive_episodes
from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.filter.verdict import FilterOptions
from ctrl_rl_safety.trials.episodes import RATE, RATES, filter_of, goal_for, model_of, period_of
from ctrl_rl_safety.trials.robot import MOTOR_LAG, TICK, TrialRobot
from ctrl_rl_safety.trials.worlds import with_whole_scan
from sim_bridge import SimulatedWorld, SimulationOptions, goal_of

Array = NDArray[np.float64]


def drive(
    task: NavigationTask | str | Path,
    policy: Policy | Actor | Driver[Sensors] | str | Path,
    seeds: Iterable[int] = range(100),
    filter: Literal["safety"] | Filter[Sensors] | None = None,  # noqa: A002 - the word of the field
    *,
    engine: str = "planar",
) -> Episodes[Sensors]:
    """Drive one episode per seed in a simulated task with a policy or any other driver.

    The base follows the constants of the robot, including lag and delay, with and without a filter.

    >>> import ctrl_rl
    >>> runs = ctrl_rl.drive("car_ttr", "car_ttr", seeds=range(2))          # a policy shipped with the suite
    >>> len(runs), runs.seeds.tolist()
    (2, [0, 1])

    Args:
        task: Navigation task, its name or its file.
        policy: Learnt policy, the name of a shipped one, a file, or an object with `command(sensors) -> command`,
            called at each scan.
        seeds: Seeds of the episodes.
        filter: "safety" to insert the safety filter between policy and robot, which then has a 360 degree lidar; or a
            function of sensors and command, called once per command of the policy.
        engine: Physics engine, one of `sim_bridge.ENGINES`.

    Raises:
        CtrlRlError: The task or policy does not exist, or the filter does not know the robot.
    """
    if not isinstance(task, NavigationTask):
        task = load_navigation_task(task)
    if isinstance(policy, Actor):
        policy = policy_of(policy)
    elif isinstance(policy, str | Path):
        policy = load_policy(find_policy(str(policy)))
    if not hasattr(policy, "command"):
        raise PolicyError(f"{type(policy).__name__} is no policy: give a learnt one, a name or a file")
    if isinstance(filter, str) and filter != "safety":
        raise SafetyError(f"no filter '{filter}': there is safety, or None for no filter")
    if filter == "safety" and task.plane != "xy":
        raise SafetyError(f"task '{task.name}': the safety filter is for robots on wheels, use the flight guard's node")
    model = model_of(task) if task.plane == "xy" else None
    options = SimulationOptions(engine=engine, rate=RATES.get(engine, RATE))
    if model is not None:
        options = replace(options, motor_lag=MOTOR_LAG)
    driver, period, goal = _driven(policy, task)
    world = SimulatedWorld(with_whole_scan(task) if filter == "safety" else task, options=options)
    try:
        make_filter = None
        if model is not None and filter == "safety":
            make_filter = lambda: filter_of(world, model, FilterOptions(period=TICK))  # noqa: E731
        robot = TrialRobot(world, model, make_filter, period=period, goal=goal)
        return drive_episodes(robot, driver, None if isinstance(filter, str) else filter, seeds)
    finally:
        world.close()


def _driven(policy: Policy | Driver[Sensors], task: NavigationTask) -> tuple[Driver[Sensors], float, Array | None]:
    """Return the driver, the duration of each command [s], and the goal given to the driver."""
    if isinstance(policy, Policy):
        return PolicyDriver(policy), period_of(policy, task), goal_for(policy, task)
    return policy, round(1.0 / task.lidar.rate / TICK) * TICK, goal_of(task)
