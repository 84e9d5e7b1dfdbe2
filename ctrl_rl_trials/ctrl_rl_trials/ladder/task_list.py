"""Tasks of the ladder; methods are tuned on the two tasks of `PRACTICE`, which do not count as results."""

from __future__ import annotations

from pathlib import Path

from ctrl_rl_core import NavigationTask, load_navigation_task

FOLDER = Path(__file__).parents[1] / "tasks"
LADDER = (
    "dead_end",
    "maze_two_turns",
    "maze_four_turns",
    "spiral",
    "loop",
    "far_start",
    "quad_tunnel",
    "quad_block",
    "quad_dead_end",
    "narrow_gap",
    "wall",
    "open_field",
)
"""Names of the tasks that count, the most informative first."""
PRACTICE = ("practice_corner", "practice_turn")
"""Names of the tasks on which methods are tuned."""
BARRIERS = ("goal_beside",)
"""Names of tasks whose time to reach jumps beside the goal: a robot that misses it has a long way back."""


def ladder_file(name_or_path: str) -> str:
    """Return the file of a ladder task, given its name; return any other argument unchanged."""
    return str(FOLDER / f"{name_or_path}.yaml") if name_or_path in (*LADDER, *PRACTICE, *BARRIERS) else name_or_path


def load_ladder_task(name_or_path: str) -> NavigationTask:
    """Read a task of the ladder, one of the suite, or a file.

    Raises:
        TaskError: There is no such task, or its file is wrong.
    """
    return load_navigation_task(ladder_file(name_or_path))
