"""Drives of the benchmark that are still to be made, each of which a worker process can make by itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ctrl_rl_trials.barn.controllers import CONTROLLERS, FILTERED_JACKAL, JACKAL, safety_check
from ctrl_rl_trials.barn.drive import BarnDrive, drive
from ctrl_rl_trials.barn.scenarios import load_scenario
from sim_bridge import SimulationOptions

_SEEDS = 1000
"""Distance between the seeds of one world."""
_MOVERS = 2.0
"""Speed of DynaBARN's obstacles that the filter assumes [m/s]; their key frames have up to 1.95 m/s between them."""


@dataclass(frozen=True)
class PlannedDrive:
    """One drive, by its terms.

    Attributes:
        folder: Checkout of the published files.
        world: Number of the world.
        controller: One of `CONTROLLERS`.
        filtered: Whether the safety filter is below the controller.
        seed: Seed of noise and drift, which differ from world to world.
        settings: Settings of the simulation.
    """

    folder: Path
    world: int
    controller: str
    filtered: bool
    seed: int
    settings: SimulationOptions

    @property
    def method(self) -> str:
        """Name of controller and filter in the table."""
        return f"{self.controller}{', filter' if self.filtered else ''}"


def make(plan: PlannedDrive) -> tuple[PlannedDrive, BarnDrive]:
    """Make a drive, and return it with its plan.

    Raises:
        TrialError: The world cannot be read.
    """
    scenario = load_scenario(plan.folder, plan.world)
    check = safety_check(_MOVERS if scenario.task.movers else 0.0) if plan.filtered else None
    controller = CONTROLLERS[plan.controller](scenario, FILTERED_JACKAL if plan.filtered else JACKAL)
    return plan, drive(scenario, controller, check, _SEEDS * plan.seed + plan.world, plan.settings)
