"""Commands that moved to `ctrl_rl_bags`: the old names still work and print the new ones."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec

from ctrl_rl_core.errors import CtrlRlError

_PACKAGE = "ctrl_rl_bags"


def bag() -> int:
    """Entry point of `ros2 run ctrl_rl_core bag`."""
    return _run("bag", "cli")


def recorder() -> int:
    """Entry point of `ros2 run ctrl_rl_core recorder`."""
    return _run("recorder", "recording.recorder_node")


def _run(name: str, module: str) -> int:
    if find_spec(_PACKAGE) is None:
        raise CtrlRlError(f"moved to the package {_PACKAGE}, which is not installed: build the whole workspace")
    sys.stderr.write(f"{name}: this command is now `ros2 run {_PACKAGE} {name}`\n")
    return int(import_module(f"{_PACKAGE}.{module}").main())
