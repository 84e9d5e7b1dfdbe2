"""Episodes of a policy in its simulated task, with the safety filter or without it: `drive` of the front door."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from ctrl_rl_core.policies.actor_policy import policy_of
from numpy.typing import NDArray

from ctrl_rl_core import (
    Actor,
    NavigationTask,
    Outcome,
    Policy,
    PolicyError,
    find_policy,
    load_navigation_task,
    load_policy,
)
from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.filter.safety_filter import SafetyFilter
from ctrl_rl_safety.filter.verdict import FilterOptions
from ctrl_rl_safety.models.robot_model import RobotModel, find_model
from ctrl_rl_safety.trials.episodes import CAR
from ctrl_rl_safety.trials.robot import MOTOR_LAG, TICK, TrialRobot
from ctrl_rl_safety.trials.sources import Driver
from ctrl_rl_safety.trials.worlds import with_whole_scan
from sim_bridge import SimulatedWorld, SimulationOptions

_RATES = {"planar": 40}
_RATE = 240


@dataclass(frozen=True)
class Episodes:
    """How episodes ended, one element for each seed.

    Attributes:
        seeds: Seeds of the episodes (N,).
        outcomes: Names of their outcomes, GOAL, COLLISION, TRAP or TIMEOUT (N,).
        seconds: Simulated durations (N,) [s].
        distances: Ways driven (N,) [m].
        changed: Part of the commands that the filter changed (N,).
        avoidable: Whether an episode ended by a contact that the robot could have avoided (N,).
    """

    seeds: NDArray[np.int64]
    outcomes: tuple[str, ...]
    seconds: NDArray[np.float64]
    distances: NDArray[np.float64]
    changed: NDArray[np.float64]
    avoidable: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.outcomes)

    @property
    def success(self) -> float:
        """Part of the episodes that reached the goal."""
        return self.rate(Outcome.GOAL)

    @property
    def collisions(self) -> float:
        """Part of the episodes that ended by a contact."""
        return self.rate(Outcome.COLLISION)

    def rate(self, outcome: Outcome) -> float:
        """Return the part of the episodes that ended so."""
        return self.outcomes.count(outcome.name) / max(len(self), 1)


def drive(
    task: NavigationTask | str | Path,
    policy: Policy | Actor | str | Path,
    seeds: Iterable[int] = range(100),
    filter: Literal["safety"] | None = None,  # noqa: A002 - the word of the field
    *,
    engine: str = "planar",
) -> Episodes:
    """Let a policy drive one episode of each seed in its simulated task.

    The base moves by the constants of the robot, its lags and delays included, whether there is a filter or not.

    >>> import ctrl_rl
    >>> runs = ctrl_rl.drive("car_ttr", "car_ttr", seeds=range(2))          # a policy that comes with the suite
    >>> len(runs), runs.seeds.tolist()
    (2, [0, 1])

    Args:
        task: Navigation task, its name or its file.
        policy: Learnt policy, the name of one that comes with the suite, or a file.
        seeds: Seeds of the episodes.
        filter: "safety" to put the safety filter between policy and robot, whose lidar then looks all around.
        engine: Physics engine, one of `sim_bridge.ENGINES`.

    Raises:
        CtrlRlError: There is no such task or policy, or the filter does not know the robot.
    """
    if not isinstance(task, NavigationTask):
        task = load_navigation_task(task)
    driver = _policy(policy)
    if filter not in (None, "safety"):
        raise SafetyError(f"no filter '{filter}': there is safety, or None for no filter")
    on_wheels = task.plane == "xy"
    if filter is not None and not on_wheels:
        raise SafetyError(f"task '{task.name}': the safety filter is for robots on wheels, use the flight guard's node")
    model = _model(task.robot.body) if on_wheels else None
    seen = task if filter is None else with_whole_scan(task)
    options = SimulationOptions(engine=engine, rate=_RATES.get(engine, _RATE))
    if model is not None:
        options = replace(options, motor_lag=MOTOR_LAG)
    world = SimulatedWorld(seen, options=options)
    rows = []
    chosen = list(seeds)
    try:
        for seed in chosen:
            world.reset(seed)
            safety = None
            if model is not None and filter is not None:
                safety = SafetyFilter(model, FilterOptions(period=TICK))
            robot, source = TrialRobot(world, model, safety), Driver(driver, task)
            while not robot.over:
                robot.drive(*source.command(world))
            outcome = world.episode().outcome.name
            rows.append((outcome, world.elapsed, robot.distance, robot.changed / robot.ticks, robot.avoidable))
    finally:
        world.close()
    outcomes, seconds, distances, changed, avoidable = zip(*rows, strict=True) if rows else ((),) * 5
    return Episodes(
        np.array(chosen, dtype=np.int64),
        tuple(outcomes),
        np.array(seconds, dtype=np.float64),
        np.array(distances, dtype=np.float64),
        np.array(changed, dtype=np.float64),
        np.array(avoidable, dtype=np.bool_),
    )


def _policy(policy: Policy | Actor | str | Path) -> Policy:
    if isinstance(policy, Actor):
        return policy_of(policy)
    if isinstance(policy, str | Path):
        return load_policy(find_policy(str(policy)))
    if not hasattr(policy, "command"):
        raise PolicyError(f"{type(policy).__name__} is no policy: give a learnt one, a name or a file")
    return policy


def _model(body: str) -> RobotModel:
    """Return the constants by which the base of a task's robot moves."""
    return CAR if body == "turtlebot2" else find_model(body)
