"""Commands that moved to `ctrl_rl_bags`: the old names still work and print the new ones."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import NoReturn

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

_PACKAGE = "ctrl_rl_bags"


def bag() -> NoReturn:
    """Entry point of `ros2 run ctrl_rl_core bag`."""
    _become("bag")


def recorder() -> NoReturn:
    """Entry point of `ros2 run ctrl_rl_core recorder`."""
    _become("recorder")


def _become(name: str) -> NoReturn:
    """Replace this process by the command: signals reach it, and the exit code is its own."""
    try:
        file = Path(get_package_prefix(_PACKAGE)) / "lib" / _PACKAGE / name
    except PackageNotFoundError:
        sys.exit(f"{name}: it moved to the package {_PACKAGE}, which is not installed: build the whole workspace")
    print(f"{name}: this command is now `ros2 run {_PACKAGE} {name}`", file=sys.stderr)  # noqa: T201
    os.execv(file, [str(file), *sys.argv[1:]])
