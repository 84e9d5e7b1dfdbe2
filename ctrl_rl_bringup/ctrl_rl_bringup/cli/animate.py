"""The command `animate`: a recorded drive as an animated GIF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from ctrl_rl_core.command import FileToWrite

from ctrl_rl_bringup.corridor.report import read_drive
from ctrl_rl_core import parse_options, run_command


@dataclass(frozen=True)
class AnimateOptions:
    """Draw a recorded drive as an animated GIF, one frame for each scan."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the run, with its bag in 'bag'."""

    output: FileToWrite = Path("drive.gif")
    """File to write."""


def animate() -> int:
    """Draw a recorded drive as an animated GIF."""
    options = parse_options("animate", AnimateOptions)
    return run_command("animate", lambda: _animate(options), failure=2)


def _animate(options: AnimateOptions) -> int:
    bag = options.folder / "bag"
    from ctrl_rl_bringup.corridor.plot import animate_drive  # matplotlib takes long to load

    animate_drive(bag, read_drive(bag), options.output)
    print(f"animation           {options.output}, {options.output.stat().st_size / 1000:.0f} kB")
    return 0
