"""Planned drives of the benchmark, each of which a worker process can execute on its own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ctrl_rl_trials.barn.controllers import CONTROLLERS, FILTERED_JACKAL, JACKAL, safety_check
from ctrl_rl_trials.barn.drive import BarnDrive, drive
from ctrl_rl_trials.barn.scenarios import load_scenario
from sim_bridge import SimulationOptions

_SEEDS = 1000
"""Offset between the seeds of two worlds."""
_MOVERS = 2.0
"""Obstacle speed that the filter assumes in DynaBARN [m/s]; the worlds' key frames imply up to 1.95 m/s."""


@dataclass(frozen=True)
class PlannedDrive:
    """Specification of one drive.

    Attributes:
        folder: Checkout of the published files.
        world: Number of the world.
        controller: One of `CONTROLLERS`.
        filtered: Whether the safety filter follows the controller.
        seed: Seed of noise and drift, which differ between worlds.
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
        """Name of controller and filter in the results table."""
        return f"{self.controller}{', filter' if self.filtered else ''}"


def make(plan: PlannedDrive) -> tuple[PlannedDrive, BarnDrive]:
    """Execute a planned drive; return the plan and its result.

    Raises:
        TrialError: The world cannot be read.
    """
    scenario = load_scenario(plan.folder, plan.world)
    check = safety_check(_MOVERS if scenario.task.movers else 0.0) if plan.filtered else None
    controller = CONTROLLERS[plan.controller](scenario, FILTERED_JACKAL if plan.filtered else JACKAL)
    return plan, drive(scenario, controller, check, _SEEDS * plan.seed + plan.world, plan.settings)
