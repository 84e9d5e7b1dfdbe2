"""The tasks with options, as environments.

environment = make_environment("tool_delivery")
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ctrl_rl_core import ToolDelivery, WaterFilling, load_task, task_names
from option_coordinator.environments.option_env import OptionEnvironment, Synchronisation
from option_coordinator.environments.tasks.team_delivery import TeamDeliverySimulation
from option_coordinator.environments.tasks.tool_delivery import ToolDeliverySimulation
from option_coordinator.environments.tasks.tool_delivery_actions import ToolDeliveryActions
from option_coordinator.environments.tasks.water_filling import OptionSet, Sight, WaterFillingSimulation
from option_coordinator.errors import OptionError
from option_coordinator.options.options import Simulation
from option_coordinator.teams.loading import load_team
from option_coordinator.teams.team_file import TeamFile, is_team, team_names

OptionTask = ToolDelivery | WaterFilling | TeamFile
Level = Literal["options", "thesis", "actions"]
"""Level of choice: the published options, those of thesis Table 5.1, or one low-level action per step."""
DISCOUNT = 0.99
"""Discount gamma of a low-level step (published settings); teams define their own."""


def load_option_task(name_or_path: str) -> OptionTask:
    """Load a task with options, or a team.

    Raises:
        CtrlRlError: The task does not exist or has no options.
    """
    if is_team(name_or_path):
        return load_team(name_or_path)
    if Path(name_or_path).suffix not in (".yaml", ".yml") and name_or_path not in task_names():
        teams = ", ".join(team_names())
        raise OptionError(
            f"no task '{name_or_path}': there are tool_delivery, water_filling, {teams}, or give a .yaml file"
        )
    task = load_task(name_or_path)
    if not isinstance(task, ToolDelivery | WaterFilling):
        raise OptionError(f"task '{task.name}' is of kind '{task.kind}': one with options is needed here")
    return task


def make_simulation(task: OptionTask, level: Level = "options", sight: Sight = "features") -> Simulation:
    """Create a task's low-level simulation, driven by options or by low-level actions ("end2end").

    Raises:
        OptionError: The task has no image observation, no such options, or no end.
    """
    if isinstance(task, WaterFilling):
        options: OptionSet = "published" if level == "options" else level
        return WaterFillingSimulation(task, options, sight)
    if sight == "image":
        raise OptionError(f"task '{task.name}' has no images: omit --sight")
    if isinstance(task, TeamFile):
        if level != "options":
            raise OptionError(f"team '{task.name}' has the options of its file: there is no other set")
        if not task.deliveries:
            raise OptionError(f"team '{task.name}' has no number of deliveries to learn with: its work arrives")
        return TeamDeliverySimulation(task)
    if level == "thesis":
        raise OptionError(f"task '{task.name}' has the options of thesis Table 5.1 and Wait: there is no other set")
    return ToolDeliverySimulation(task) if level == "options" else ToolDeliveryActions(task)


def make_environment(
    name_or_path: str,
    synchronisation: Synchronisation = "async",
    discount: float | None = None,
    level: Level = "options",
    sight: Sight = "features",
    film: bool = False,
    drop: float = 0.0,
) -> OptionEnvironment:
    """Create the event-driven environment of a task; the discount defaults to the task's own.

    Raises:
        CtrlRlError: As for `load_option_task` and `make_simulation`.
    """
    task = load_option_task(name_or_path)
    discount = discount_of(task) if discount is None else discount
    return OptionEnvironment(make_simulation(task, level, sight), discount, synchronisation, film, drop)


def discount_of(task: OptionTask) -> float:
    """Return the discount gamma of a low-level step."""
    return task.discount if isinstance(task, TeamFile) else DISCOUNT
