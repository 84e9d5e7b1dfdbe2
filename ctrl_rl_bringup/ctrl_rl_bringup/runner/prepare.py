"""Prepares a run: its new folder, and the value functions to serve during a drive."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ctrl_rl_bringup.runner.stack import DriveConfig
from ctrl_rl_core import CtrlRlError, NavigationTask, ValueGrid, load_navigation_task

if TYPE_CHECKING:
    from ttr_reward_node import DecomposedValue


def new_run(options: DriveConfig) -> None:
    """Check the task of a run and make its folder.

    Raises:
        CtrlRlError: There is no such task or width, or the folder exists or cannot be made.
    """
    load_navigation_task(options.task).build_world(options.width or None)
    try:
        options.folder.mkdir(parents=True)
    except FileExistsError:
        raise CtrlRlError(f"{options.folder} exists: give another folder") from None
    except OSError as error:
        raise CtrlRlError(f"cannot make {options.folder}: {error.strerror}") from None


def value_files(options: DriveConfig) -> dict[str, Path]:
    """Return the files of the value functions to serve during a drive, by kind; print which are missing.

    `time_to_reach` is solved now, for the robot's size, and written beside the bag; `oc_value` ships with its package.
    """
    from oc_baseline_node import find_value, shipped_values  # Numba takes long to load

    task, out = load_navigation_task(options.task), {}
    if not task.grid:
        _say(f"no reward and no time to reach: task '{task.name}' has no 'grid'")
    elif options.randomise_width:
        _say("no reward and no time to reach: the corridor's width is drawn at random")
    else:
        _say("solving the time to reach ...")
        out["time_to_reach"] = options.folder / "time_to_reach.safetensors"
        _time_to_reach(task, options.width or None).save(out["time_to_reach"])
    if task.name in shipped_values():
        out["oc_value"] = find_value(task.name)
    else:
        _say(f"no optimal control value: there is none of task '{task.name}'; make one with 'oc data' and 'oc fit'")
    return out


def _time_to_reach(task: NavigationTask, width: float | None) -> ValueGrid | DecomposedValue:
    """Solve the time to reach; a quadrotor's, whose full grid exceeds any memory, in two parts."""
    from ttr_reward_node import find_decomposition, solve_decomposed, solve_task  # Numba takes long to load

    if task.plane == "xy":
        return solve_task(task, width=width, inflation=task.robot.radius)
    return solve_decomposed(task, find_decomposition(task.system.build(), "4d+4d"))


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")
