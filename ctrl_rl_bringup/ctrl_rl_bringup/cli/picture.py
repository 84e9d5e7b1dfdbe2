"""`python -m ctrl_rl_bringup.cli.picture FOLDER`: the README's moving picture, from a drive by the real nodes."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from ctrl_rl_core.command import FileToWrite

from ctrl_rl_bringup.corridor.report import read_drive
from ctrl_rl_core import parse_options, run_command


@dataclass(frozen=True)
class PictureOptions:
    """Drive through a warehouse that a person crosses, and draw the drive over the time to reach the goal."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the run; if it holds a drive, that is drawn again."""
    output: FileToWrite = Path("docs/images/hero.gif")
    """File to write."""
    speed: float = 1.0
    """Simulation time per wall time."""


def picture() -> int:
    """Drive, unless the folder holds a drive, and draw the drive."""
    options = parse_options("picture", PictureOptions)
    return run_command("picture", lambda: _picture(options), failure=2)


def _picture(options: PictureOptions) -> int:
    from ctrl_rl_bringup.hero.film import drive

    bag = options.folder / "bag"
    report = read_drive(bag) if bag.exists() else drive(options.folder, options.speed)
    print(report.text())
    from ctrl_rl_bringup.hero.film import draw  # matplotlib takes long to load

    draw(report, options.output)
    print(f"picture             {options.output}, {options.output.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(picture())
