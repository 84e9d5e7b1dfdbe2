"""Helpers of this package's commands: where their nodes are heard, and the folder of a new run."""

from __future__ import annotations

import sys
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

from rclpy._rclpy_pybind11 import UnknownROSArgsError
from rclpy.utilities import remove_ros_args

from ctrl_rl_bringup.runner.domain import own_domain, stay_local
from ctrl_rl_core import run_command


def run_here(program: str, work: Callable[[], int]) -> int:
    """Run a command whose nodes communicate on this machine only; return its exit code."""
    stay_local()
    return run_command(program, work, failure=2)


def run_alone(program: str, work: Callable[[], int]) -> int:
    """Run a command that starts nodes, in its own ROS domain; return its exit code."""

    def alone() -> int:
        with own_domain(program):
            return work()

    return run_here(program, alone)


def run_folder(output: Path | None, name: str) -> Path:
    """Return the folder of a new run, by default runs/<name>-<date>-<time>."""
    return output or Path("runs") / f"{name}-{datetime.now():%Y%m%d-%H%M%S}"


def own_arguments(program: str) -> list[str]:
    """Return the process's arguments without those that ROS's launch adds after --ros-args.

    Unknown ROS arguments end the process with one line and exit code 2.
    """
    try:
        return list(remove_ros_args(sys.argv)[1:])
    except UnknownROSArgsError as error:
        print(f"{program}: unknown ROS argument {error}: see {program} --help", file=sys.stderr)
        raise SystemExit(2) from None
