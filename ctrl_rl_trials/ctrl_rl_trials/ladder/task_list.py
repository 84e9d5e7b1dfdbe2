"""The tasks of the ladder, from easy to hard; methods are set on the two of `PRACTICE`, which do not count."""

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
"""Names of the tasks that count, those that tell most first."""
PRACTICE = ("practice_corner", "practice_turn")
"""Names of the tasks that methods are set on."""


def ladder_file(name_or_path: str) -> str:
    """Return the file of a task of the ladder by its name; anything else as it is."""
    return str(FOLDER / f"{name_or_path}.yaml") if name_or_path in (*LADDER, *PRACTICE) else name_or_path


def load_ladder_task(name_or_path: str) -> NavigationTask:
    """Read a task of the ladder, one of the suite, or a file.

    Raises:
        TaskError: There is no such task, or its file is wrong.
    """
    return load_navigation_task(ladder_file(name_or_path))
