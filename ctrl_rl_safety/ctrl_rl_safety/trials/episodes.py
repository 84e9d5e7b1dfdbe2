"""One trial episode: the source of commands, the place, the robot, and the guard between them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sim_bridge.simulation import draw_map

from ctrl_rl_core import (
    Driver,
    Episode,
    NavigationTask,
    Outcome,
    Policy,
    PolicyDriver,
    Sensors,
    drive,
    find_policy,
    load_navigation_task,
    load_policy,
    task_digest,
    task_names,
)
from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.filter.map_walls import MapWalls
from ctrl_rl_safety.filter.safety_filter import SafetyFilter
from ctrl_rl_safety.filter.sensor_filter import SensorFilter
from ctrl_rl_safety.filter.verdict import FilterOptions
from ctrl_rl_safety.models.robot_model import ROBOTS, RobotModel, find_model
from ctrl_rl_safety.trials.robot import MOTOR_LAG, TICK, TrialRobot
from ctrl_rl_safety.trials.sources import Constant, Random
from ctrl_rl_safety.trials.worlds import PLACES, room, with_movers, with_whole_scan
from sim_bridge import SimulatedWorld, SimulationOptions, goal_of

Array = NDArray[np.float64]

ADVERSARIES = ("full_speed", "random", "attacker")
"""Adversarial sources; the last one is a policy trained by `train --attackers` against the filter."""
_ATTACKERS = Path(__file__).parent / "attackers"
GUARDS = {
    "none": "no filter",
    "filter": "filter",
    "map": "filter with the map",
    "mismatch": "filter, robot off its model",
    "late": "filter, commands 0.7 s late",
    "alone": "nobody there",
}
"""Names of the guards in results.

With `mismatch` the robot has 10 % less braking and 30 ms more delay than the filter assumes; with `late` the filter
knows the delay, and the wheels move as the engine's motors do; with `alone` nothing moves.
"""
UNGUARDED = ("none", "alone")
"""Guards without the filter, used as the reference."""
_LESS_BRAKING, _MORE_DELAY, _LATE = 0.9, 0.03, 0.7
CAR = RobotModel(
    "car", ROBOTS["turtlebot2"].radius, 2.0, 0.8, 0.5, 3.1, 3.1, 25.2, 0.05, 0.0, 0.08, 0.03, 0.0, track=0.23
)
"""The car of `car_ttr` and `car_navigation`, whose motor force limits speed and turn rate together."""
_SIZE = 4.0
"""Extent of movers reported to the filter, relative to the largest radius in a task."""
RATES, RATE = {"planar": 40}, 240
"""Physics steps per second [Hz] by engine, and the default."""
_WITH_SET = 20
"""Interval of an adversary's episodes with the recoverable set, which takes most of the time; the others use fixed
escapes only, as on a robot whose set is late."""


@dataclass(frozen=True)
class Cell:
    """Trial condition: the common settings of episodes that differ only in their seed.

    Attributes:
        source: Adversary, or name of a policy.
        place: One of `worlds.PLACES`, or the name of the policy's task.
        robot: Robot of an adversary, a key of `ROBOTS`; empty for the task's robot.
        guard: Guard, a key of `GUARDS`.
    """

    source: str
    place: str
    robot: str
    guard: str

    @property
    def method(self) -> str:
        """Name of the condition in results."""
        own = not self.robot and self.source.startswith(self.place)
        return ", ".join(
            each for each in (self.source, "" if own else self.place, self.robot, GUARDS[self.guard]) if each
        )


@dataclass(frozen=True)
class TrialOutcome:
    """Result of one episode.

    Attributes:
        seed: Seed of the episode.
        end: Name of the outcome.
        seconds: Simulated duration [s].
        avoidable: Whether the episode ended in a contact that the robot could have avoided.
        run_into: Whether the episode ended with a mover running into the stationary robot.
        changed: Fraction of the commands changed by the filter.
        distance: Distance driven [m].
    """

    seed: int
    end: str
    seconds: float
    avoidable: bool
    run_into: bool
    changed: float
    distance: float

    @property
    def succeeded(self) -> bool:
        """Whether the robot reached its goal."""
        return self.end == Outcome.GOAL.name


def task_of(policy: str) -> str:
    """Return the task named at the start of a policy's name.

    Raises:
        SafetyError: The name has no task.
    """
    found = max((task for task in task_names() if policy.startswith(task)), key=len, default="")
    if not found:
        raise SafetyError(f"policy '{policy[:60]}' does not begin with the name of a task")
    return found


def trial_outcome(episode: Episode[Sensors]) -> TrialOutcome:
    """Return the outcome of a `TrialRobot`'s episode."""
    info = episode.info
    return TrialOutcome(
        episode.seed,
        episode.outcome,
        round(info["seconds"], 4),
        info["avoidable"],
        info["run_into"],
        episode.changed,
        round(info["distance"], 4),
    )


class Player:
    """Runs the episodes of a condition with a wheeled robot."""

    def __init__(self, cell: Cell, engine: str, scan_rate: float = 0.0, movers: int = 0) -> None:
        """Load the data shared by all episodes.

        Args:
            cell: Trial condition.
            engine: Physics engine, one of `sim_bridge.ENGINES`.
            scan_rate: Scans per second in the task of a policy [Hz]; 0 for the task's own.
            movers: Number of additional movers that wander in the task of a policy.

        Raises:
            CtrlRlError: The policy, task or robot does not exist, or the policy is for another kind of robot.
        """
        self._cell = cell
        self._options = SimulationOptions(engine=engine, rate=RATES.get(engine, RATE), motor_lag=MOTOR_LAG)
        self._policy: Policy | None = None
        self._task: NavigationTask | None = None
        if cell.place in PLACES:
            self._model = ROBOTS[cell.robot]
        else:
            self._task = with_movers(with_whole_scan(load_navigation_task(cell.place), scan_rate), movers)
            self._model = model_of(self._task)
        if cell.guard == "late":
            self._options = SimulationOptions(engine=engine, command_delay=_LATE)
            self._model = replace(self._model, delay=_LATE)
        if cell.source == "attacker":
            self._policy = load_policy(_ATTACKERS / f"{cell.robot}.safetensors")
        elif cell.source not in ADVERSARIES:
            self._policy = load_policy(find_policy(cell.source))
            if self._policy.robot != "differential_drive":
                raise SafetyError(
                    f"policy '{cell.source}' is for a {self._policy.robot}: give one of a robot on wheels"
                )

    @property
    def terms(self) -> list[str]:
        """Text that identifies everything the episodes depend on, such as robot and task."""
        return [repr(self._model), "" if self._task is None else task_digest(self._task)]

    def play(self, seed: int) -> TrialOutcome:
        """Run the episode of a seed; with adversaries, only every twentieth uses the recoverable set."""
        cell, model, policy = self._cell, self._model, self._policy
        task = self._task or room(cell.place, model.name, model, seed)
        if cell.guard == "alone":
            task = task.model_copy(update={"movers": ()})
        base: RobotModel | None = None if cell.guard == "late" else model
        if cell.guard == "mismatch":
            base = replace(model, braking=_LESS_BRAKING * model.braking, delay=model.delay + _MORE_DELAY)
        world = SimulatedWorld(task, seed, options=self._options)
        try:
            make_filter = None if cell.guard in UNGUARDED else lambda: self._filter(world)
            if policy is None:
                driver: Driver[Sensors] = (
                    Constant((model.speed, 0.0)) if cell.source == "full_speed" else Random(model, seed)
                )
                robot = TrialRobot(world, base, make_filter, blind=True)
            else:
                own = task if self._task is None else load_navigation_task(cell.place)
                driver = PolicyDriver(policy)
                robot = TrialRobot(world, base, make_filter, period=period_of(policy, own), goal=goal_for(policy, own))
            (episode,) = drive(robot, driver, seeds=(seed,))
            return trial_outcome(episode)
        finally:
            world.close()

    def _filter(self, world: SimulatedWorld) -> SensorFilter:
        cell, movers = self._cell, world.task.movers
        options = FilterOptions(period=TICK, mover_speed=max((_fastest(each) for each in movers), default=0.0))
        if self._task is not None and movers:
            options = replace(options, mover_size=_SIZE * max(each.radius for each in movers))
        walls = MapWalls(draw_map(world.task, world.geometry)) if cell.guard == "map" else None
        with_set = cell.source not in ADVERSARIES or world.seed % _WITH_SET == 0
        return filter_of(world, self._model, options, 0.0 if with_set else math.inf, walls)


def model_of(task: NavigationTask) -> RobotModel:
    """Return the constants that govern the base of a task's robot."""
    return CAR if task.robot.body == "turtlebot2" else find_model(task.robot.body)


def filter_of(
    world: SimulatedWorld,
    model: RobotModel,
    options: FilterOptions,
    set_period: float = 0.0,
    walls: MapWalls | None = None,
) -> SensorFilter:
    """Return the safety filter of a world's robot, see `SensorFilter`."""
    robot = world.task.robot.robot
    assert robot is not None, "a robot on wheels"
    return SensorFilter(SafetyFilter(model, options), robot.lidar.x, set_period, walls)


def period_of(policy: Policy, task: NavigationTask) -> float:
    """Return a policy's decision period, a whole number of ticks [s]: its own, or the scan period."""
    period = 1.0 / task.lidar.rate if policy.period is None else policy.period
    return round(period / TICK) * TICK


def goal_for(policy: Policy, task: NavigationTask) -> Array | None:
    """Return the centre of a task's goal (3,), if the policy needs it."""
    return goal_of(task) if "goal" in policy.needs else None


def _fastest(mover: object) -> float:
    """Return the maximum speed of a task's movers [m/s]."""
    way = getattr(mover, "track", None) or getattr(mover, "wander", None)
    if way is None:
        raise SafetyError("a mover by key frames has no bound on its speed: give a task without one")
    return float(way.speed.high)
