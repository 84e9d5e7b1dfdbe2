"""What a drive needs before its nodes start: a folder of its own, and the time to reach that the reward is made of."""

from __future__ import annotations

import sys
from pathlib import Path

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.tasks import load_navigation_task
from ttr_reward_node.solver import solve_task

from ctrl_rl_bringup.stack import DriveOptions


def new_run(options: DriveOptions) -> None:
    """Check the task of a run and make its folder.

    Raises:
        CtrlRlError: there is no such task, or the folder exists or cannot be made.
    """
    load_navigation_task(options.task)
    try:
        options.folder.mkdir(parents=True)
    except FileExistsError:
        raise CtrlRlError(f"{options.folder} exists: give another folder") from None
    except OSError as error:
        raise CtrlRlError(f"cannot make {options.folder}: {error.strerror}") from None


def solve_time_to_reach(options: DriveOptions) -> Path | None:
    """Solve the task's time to reach for the robot's own size, write it beside the bag, and return the file.

    None, and a line that says why, where the drive must do without reward: the task file asks for no grid, or the width
    of the corridor is not known before.
    """
    task = load_navigation_task(options.task)
    if not task.grid or options.randomise_width:
        why = "the corridor's width is drawn at random" if task.grid else f"task '{task.name}' has no 'grid'"
        sys.stderr.write(f"no reward and no time to reach: {why}\n")
        return None
    sys.stderr.write("solving the time to reach ...\n")
    grid = solve_task(task, width=options.width or None, inflation=task.robot.radius)
    path = options.folder / "time_to_reach.safetensors"
    grid.save(path)
    return path
