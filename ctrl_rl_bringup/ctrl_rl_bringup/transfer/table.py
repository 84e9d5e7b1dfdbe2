"""The transfer table: success of policies in each engine, nominal and shifted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from ctrl_rl_core.io import digest
from ctrl_rl_core.ros import of_robot
from ctrl_rl_core.tasks import CONDITIONS

from ctrl_rl_bringup.runner.stack import through_doorways
from ctrl_rl_core import (
    LIDAR_PARAMETERS,
    DriveSafety,
    Episode,
    NavigationTask,
    ObstacleStop,
    Outcome,
    Policy,
    PolicyDriver,
    Result,
    ScanHealth,
    Sensors,
    drive,
    task_digest,
)
from sim_bridge import SimulatedRobot, SimulatedWorld, SimulationOptions, goal_of

_DEFAULTS = {parameter.name: parameter.default for parameter in LIDAR_PARAMETERS}
_FASTEST = 1.0
_STANDS = 60.0


def play_episode(policy: Policy, task: NavigationTask, seed: int, options: SimulationOptions) -> Episode[Sensors]:
    """Drive one episode from its start to its end, or until the robot has stood still for a minute.

    Args:
        policy: Policy of the task's robot.
        task: Task to drive in; the centre of its goal is the policy's goal, if it needs one.
        seed: Seed of the episode.
        options: Settings of the simulation.
    """
    world = SimulatedWorld(task, seed, options=options)
    try:
        period = 1.0 / world.lidar.spec.rate if policy.period is None else policy.period
        robot = SimulatedRobot(world, period, goal_of(task) if "goal" in policy.needs else None, _STANDS)
        check = _make_safety(task) if policy.period is None else None
        (episode,) = drive(robot, PolicyDriver(policy), check, seeds=(seed,))
        return episode
    finally:
        world.close()


def _make_safety(task: NavigationTask) -> DriveSafety:
    """Return the checks of a lidar node, with defaults or with values that leave room in doorways."""
    robot = task.robot.robot
    assert robot is not None, "a robot with a lidar on wheels"
    value = _DEFAULTS | {each.name: of_robot(robot, each.of_robot) for each in LIDAR_PARAMETERS if each.of_robot}
    value |= {} if task.doorways is None else through_doorways(task)
    health = ScanHealth(value["min_echo_share"], value["largest_gap"], value["frozen_scans"])
    obstacles = ObstacleStop(
        value["robot_radius"], value["obstacle_margin"], value["deceleration"], value["reaction_time"]
    )
    return DriveSafety(health, obstacles, value["lidar_x"], _FASTEST)


NOMINAL = "nominal"
SHIFTS: Mapping[str, Mapping[str, Any]] = {
    NOMINAL: {},
    "floor half as rough": {"friction": 0.5},
    "floor a tenth as rough": {"friction": 0.1},
    "wheels 5 % smaller": {"wheel_radius": 0.95},
    "wheels 5 % larger": {"wheel_radius": 1.05},
    "wheels 20 % smaller": {"wheel_radius": 0.8},
    "wheels 20 % larger": {"wheel_radius": 1.2},
    "commands 0.05 s late": {"command_delay": 0.05},
    "commands 0.2 s late": {"command_delay": 0.2},
    "motors four times slower": {"motor_lag": 0.2},
    "ranges noisy by 3 cm": {"scan_noise": 0.03},
    "one beam in five lost": {"scan_dropout": 0.2},
    "odometry drifts by 10 %": {"odom_drift": 0.1},
    "as on a TurtleBot3": {
        "lidar": "lds02",
        "scan_dropout": 0.1,
        "odom_drift": 0.05,
        "command_delay": 0.1,
        "command_truncation": True,
    },
}
"""Options of the simulation, by shift."""


@dataclass(frozen=True)
class Entry:
    """What to drive: one policy, or those of several runs of a method.

    Attributes:
        name: Name in the table.
        task: Task to drive in.
        policies: Policies, each by the digest of its file.
    """

    name: str
    task: NavigationTask
    policies: Mapping[str, Policy]

    def shifts(self, wanted: Iterable[str]) -> list[str]:
        """Return the wanted shifts that apply to the task's robot."""
        rolls = self.task.plane == "xy"
        turtlebot3 = self.task.robot.body.startswith("turtlebot3")

        def suits(shift: str) -> bool:
            changes = SHIFTS[shift]
            wheels = any(name in CONDITIONS and CONDITIONS[name].wheels for name in changes)
            return (rolls or not wheels) and (turtlebot3 or "lidar" not in changes)

        return [shift for shift in wanted if suits(shift)]


@dataclass(frozen=True)
class Cell:
    """One entry in one engine under one shift.

    Attributes:
        entry: Name of the entry.
        engine: Name of the engine.
        shift: Name of the shift.
        reached: Whether each episode ended at the goal; of several policies the fraction for each.
        collided: Whether each episode ended in a collision; of several policies the fraction for each.
        randomised: Whether training drew conditions from ranges.
        digest: Digest of policies, task, conditions and seeds.
    """

    entry: str
    engine: str
    shift: str
    reached: Sequence[float]
    collided: Sequence[float]
    randomised: bool = False
    digest: str = ""

    @property
    def success(self) -> float:
        """Fraction of episodes that ended at the goal."""
        return float(np.mean(self.reached))

    @property
    def method(self) -> str:
        """Name of its rows in the table of results."""
        return ", ".join((self.entry, self.engine, self.shift, *(("randomised",) if self.randomised else ())))

    def text(self) -> str:
        """Return the cell as a line."""
        return f"{self.method:<64} {self.success:4.0%} reach the goal, {np.mean(self.collided):4.0%} collide"

    def results(self) -> list[Result]:
        """Return the rows of the table of results."""
        return [
            Result(self.method, "success", "1", [float(each) for each in self.reached]),
            Result(self.method, "collision", "1", [float(each) for each in self.collided]),
        ]


def plan_cells(
    entries: Sequence[Entry], engines: Sequence[str], shifts: Sequence[str], seeds: Sequence[int]
) -> list[tuple[Entry, Cell]]:
    """Return the cells to fill, shift by shift, so that an interrupted run still compares all entries."""
    out = []
    for shift in shifts:
        for entry in entries:
            for engine in engines if entry.shifts([shift]) else ():
                terms = {
                    "policies": list(entry.policies),
                    "task": task_digest(entry.task),
                    "options": asdict(_options(entry.task, engine, shift)),
                    "seeds": list(seeds),
                }
                drawn = bool(entry.task.randomisation)
                out.append((entry, Cell(entry.name, engine, shift, (), (), drawn, digest(terms))))
    return out


def drive_cells(
    cells: Iterable[tuple[Entry, Cell]], seeds: Sequence[int], on_episode: Callable[[], object] = lambda: None
) -> Iterator[Cell]:
    """Drive the episodes of each cell.

    Args:
        cells: Cells that `plan_cells` returned.
        seeds: Seeds of the episodes.
        on_episode: Function that is called after each episode.
    """
    for entry, cell in cells:
        options = _options(entry.task, cell.engine, cell.shift)
        ends = np.empty((len(entry.policies), len(seeds)), object)
        for row, policy in enumerate(entry.policies.values()):
            for column, seed in enumerate(seeds):
                ends[row, column] = play_episode(policy, entry.task, seed, options).outcome
                on_episode()
        reached, collided = ends == Outcome.GOAL.name, ends == Outcome.COLLISION.name
        if len(ends) > 1:
            reached, collided = reached.mean(axis=1, keepdims=True), collided.mean(axis=1, keepdims=True)
        yield replace(
            cell, reached=tuple(reached.astype(float).ravel()), collided=tuple(collided.astype(float).ravel())
        )


def transfer_ratios(cells: Sequence[Cell], home: str) -> dict[str, float]:
    """Return each entry's nominal success in the other engines, relative to that in its training engine."""
    nominal = {(cell.entry, cell.engine): cell.success for cell in cells if cell.shift == NOMINAL}
    return {
        f"{entry}, {engine}": success / nominal[entry, home]
        for (entry, engine), success in nominal.items()
        if engine != home and nominal.get((entry, home), 0.0) > 0.0
    }


def _options(task: NavigationTask, engine: str, shift: str) -> SimulationOptions:
    nominal = SimulationOptions(engine=engine, randomise=False, randomise_width=task.corridor is not None)
    return replace(nominal, **SHIFTS[shift])
