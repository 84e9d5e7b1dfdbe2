"""Commands that moved to `ctrl_rl_bags`; the old names still work, and `entry` prints the new ones."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

from ctrl_rl_core.entry import MOVED_TO
from ctrl_rl_core.errors import CtrlRlError


def bag() -> int:
    """Entry point of `ros2 run ctrl_rl_core bag`."""
    return _run("cli")


def recorder() -> int:
    """Entry point of `ros2 run ctrl_rl_core recorder`."""
    return _run("recording.recorder_node")


def _run(module: str) -> int:
    if find_spec(MOVED_TO) is None:
        raise CtrlRlError(f"moved to the package {MOVED_TO}, which is not installed: build the whole workspace")
    return int(import_module(f"{MOVED_TO}.{module}").main())
