"""Requirements of each command on a task, in one table: commands call `require`, and the documentation shows the table.

A command rejects an unsuitable task before any computation, with a one-line reason.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from ctrl_rl_core.tasks.default_grid import with_grid
from ctrl_rl_core.tasks.schema.parts import TaskHeader
from ctrl_rl_core.tasks.task import NavigationTask, TaskError

TEAM = "team_delivery"
"""Kind of a team file."""
_WITH_OPTIONS = ("tool_delivery", "water_filling", TEAM)


class Need(NamedTuple):
    """A requirement of a command on a task.

    Attributes:
        lacks: Describes what a task lacks, as text that follows "task 'NAME' "; empty if nothing.
        part: Part of the task file that would fix it, if any.
    """

    lacks: Callable[[TaskHeader], str]
    part: str = ""


def _of_navigation(lacks: Callable[[NavigationTask], str], part: str = "") -> Need:
    """Return a requirement that only navigation tasks can meet."""

    def check(task: TaskHeader) -> str:
        if not isinstance(task, NavigationTask):
            return f"is of kind '{_kind(task)}': a navigation task is needed here"
        return lacks(task)

    return Need(check, part)


def _kind(task: TaskHeader) -> str:
    return str(getattr(task, "kind", "unknown"))


def _no_corridor(task: NavigationTask) -> str:
    return "" if task.corridor else "has no corridor: there are curved_corridor and corridor_doorways"


def _has_corridor(task: NavigationTask) -> str:
    commands = "`ros2 run ctrl_rl_learning teach` or `ros2 run koopman_lqr_controller train`"
    return f"has a corridor: learn it with {commands}" if task.corridor else ""


def _no_fleet(task: NavigationTask) -> str:
    parts = [name for name in ("movers", "randomisation") if getattr(task, name)]
    robot = task.robot.robot
    parts += ["steered wheels"] if robot is not None and robot.steering is not None else []
    # The other train simulates one robot at a time where it must.
    return f"has {parts[0]}, which no fleet simulates: learn it with `ros2 run ttr_reward_node train`" if parts else ""


def _other_walls(task: NavigationTask) -> str:
    if task.doorways is None:
        return ""
    return "has partitions that move in each episode: name one with fixed walls, such as curved_corridor"


def _no_grid(task: NavigationTask) -> str:
    states = ", ".join(task.system.build().state_names)
    return "" if with_grid(task).grid else f"has no value grid: add 'grid' with an axis for each of {states}"


def _no_wheels(task: NavigationTask) -> str:
    if set(task.robot.commands) == {"v", "omega"}:
        return ""
    return f"is steered by {' and '.join(task.robot.commands)}: v and omega are needed here"


def _no_pose(task: NavigationTask) -> str:
    states = task.system.build().state_names
    if states == ("x", "y", "theta"):
        return ""
    return f"has the states {', '.join(states)}: a model of motion needs x, y, theta; take another --method"


def _no_optimal_control(task: NavigationTask) -> str:
    return "" if task.optimal_control else "has no part 'optimal_control': add its constants to the task file"


def _has_map(task: NavigationTask) -> str:
    return "has a map: an optimal control problem is of an arena or a corridor" if task.map else ""


def _no_options(task: TaskHeader) -> str:
    kind = _kind(task)
    return "" if kind in _WITH_OPTIONS else f"is of kind '{kind}': one with options is needed here"


def _no_team(task: TaskHeader) -> str:
    return "" if _kind(task) == TEAM else f"is of kind '{_kind(task)}': a team file is needed here"


NAVIGATION = _of_navigation(lambda _: "")
CORRIDOR = _of_navigation(_no_corridor)
OPEN = _of_navigation(_has_corridor)
FLEET = _of_navigation(_no_fleet)
LASTING_WALLS = _of_navigation(_other_walls)
GRID = _of_navigation(_no_grid, "grid")
WHEELS = _of_navigation(_no_wheels)
POSE = _of_navigation(_no_pose)
OPTIMAL_CONTROL = _of_navigation(_no_optimal_control, "optimal_control")
NO_MAP = _of_navigation(_has_map)
OPTIONS = Need(_no_options)
TEAM_FILE = Need(_no_team)

COMMANDS: Mapping[str, tuple[Need, ...]] = {
    "ctrl_rl_bringup demo": (NAVIGATION,),
    "ctrl_rl_bringup trials": (NAVIGATION,),
    "ctrl_rl_bringup record_drives": (WHEELS,),
    "ctrl_rl_bringup options_demo": (TEAM_FILE,),
    "ctrl_rl_learning teach": (CORRIDOR,),
    "ctrl_rl_learning fine_tune": (WHEELS, LASTING_WALLS),
    "ctrl_rl_learning improve": (WHEELS,),
    "ctrl_rl_learning learn_offline --method bc": (NAVIGATION,),
    "ctrl_rl_learning learn_offline --method td3bc": (NAVIGATION,),
    "ctrl_rl_learning learn_offline --method iql": (NAVIGATION,),
    "ctrl_rl_learning learn_offline --method cql": (NAVIGATION,),
    "ctrl_rl_learning learn_offline --method value_weight": (NAVIGATION,),
    "ctrl_rl_learning learn_offline --method value_model": (POSE,),
    "ctrl_rl_learning learn_offline --method value_critic": (NAVIGATION,),
    "ctrl_rl_learning evaluate_offline": (NAVIGATION,),
    "ctrl_rl_trials train": (OPEN, FLEET, GRID),
    "ctrl_rl_trials hardness": (OPEN, FLEET),
    "ctrl_rl_trials loop": (WHEELS, GRID),
    "ctrl_rl_trials correlation": (WHEELS, GRID),
    "koopman_lqr_controller edmd": (WHEELS,),
    "koopman_lqr_controller train": (CORRIDOR,),
    "oc_baseline_node oc data": (OPTIMAL_CONTROL, NO_MAP),
    "oc_baseline_node train": (OPEN, OPTIMAL_CONTROL, NO_MAP),
    "option_coordinator train": (OPTIONS,),
    "ttr_reward_node solve": (NAVIGATION, GRID),
    "ttr_reward_node train": (OPEN,),
    "ttr_reward_node evaluate": (OPEN,),
}
"""Requirements of each command that takes a task, by its `ros2 run` arguments."""


def unmet(command: str, task: TaskHeader) -> Need | None:
    """Return a requirement of a command that a task does not meet, or None.

    A requirement that no part of the task file would fix comes first: the part would not help.

    Raises:
        KeyError: The command is not in the table.
    """
    return min((need for need in COMMANDS[command] if need.lacks(task)), key=lambda need: need.part != "", default=None)


def can(command: str, task: TaskHeader) -> str:
    """Return the one-line reason why a command cannot work on a task, or "" if it can.

    Raises:
        KeyError: The command is not in the table.
    """
    need = unmet(command, task)
    return "" if need is None else f"task '{task.name}' {need.lacks(task)}"


def require(command: str, task: TaskHeader) -> None:
    """Raise unless a command can work on a task.

    Raises:
        TaskError: The command cannot work on the task; the message gives the reason.
    """
    if reason := can(command, task):
        raise TaskError(reason)
