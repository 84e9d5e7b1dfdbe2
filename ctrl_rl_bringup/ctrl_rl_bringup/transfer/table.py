"""The transfer table: success of policies in each engine, nominal and shifted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ctrl_rl_bringup.transfer.in_process import play_episode
from ctrl_rl_core import NavigationTask, Outcome, Policy, Result
from sim_bridge import SimulationOptions

NOMINAL = "nominal"
SHIFTS: Mapping[str, Mapping[str, Any]] = {
    NOMINAL: {},
    "floor half as rough": {"friction": 0.5},
    "wheels 5 % smaller": {"wheel_radius": 0.95},
    "wheels 5 % larger": {"wheel_radius": 1.05},
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
"""Options of the simulation by what they stand for."""


@dataclass(frozen=True)
class Cell:
    """One policy in one engine under one shift.

    Attributes:
        policy: Name of the policy.
        engine: Name of the engine.
        shift: Name of the shift.
        reached: Whether each episode ended at the goal.
        collided: Whether each episode ended in a collision.
    """

    policy: str
    engine: str
    shift: str
    reached: tuple[bool, ...]
    collided: tuple[bool, ...]

    @property
    def success(self) -> float:
        """Share of the episodes that ended at the goal."""
        return sum(self.reached) / len(self.reached)

    def text(self) -> str:
        """Return the cell in a line."""
        count = f"{sum(self.reached):>3} of {len(self.reached)} reach the goal, {sum(self.collided)} collide"
        return f"{self.policy:<24} {self.shift:<26} {self.engine:<9} {count}"

    def results(self) -> list[Result]:
        """Return the rows of the table of results."""
        method = f"{self.policy}, {self.engine}, {self.shift}"
        return [
            Result(method, "success", "1", [float(each) for each in self.reached]),
            Result(method, "collision", "1", [float(each) for each in self.collided]),
        ]


def drive_cells(
    policies: Mapping[str, tuple[Policy, NavigationTask]],
    engines: Sequence[str],
    shifts: Sequence[str],
    seeds: Sequence[int],
) -> Iterator[Cell]:
    """Drive each policy in its task, in each engine under each shift.

    Args:
        policies: Policy and its task by name.
        engines: Names of engines.
        shifts: Names of shifts, of `SHIFTS`.
        seeds: Seeds of the episodes.
    """
    for shift in shifts:
        for name, (policy, task) in policies.items():
            for engine in engines:
                nominal = SimulationOptions(engine=engine, randomise=False, randomise_width=task.corridor is not None)
                options = replace(nominal, **SHIFTS[shift])
                ends = [play_episode(policy, task, seed, options).outcome for seed in seeds]
                reached = tuple(end is Outcome.GOAL for end in ends)
                yield Cell(name, engine, shift, reached, tuple(end is Outcome.COLLISION for end in ends))


def transfer_ratios(cells: Sequence[Cell], home: str) -> dict[str, float]:
    """Return the nominal success of each policy in the other engines, over that in the engine it was learnt in."""
    nominal = {(cell.policy, cell.engine): cell.success for cell in cells if cell.shift == NOMINAL}
    return {
        f"{policy}, {engine}": success / nominal[policy, home]
        for (policy, engine), success in nominal.items()
        if engine != home and nominal.get((policy, home), 0.0) > 0.0
    }
