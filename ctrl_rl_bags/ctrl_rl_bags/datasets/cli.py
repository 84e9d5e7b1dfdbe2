"""The commands `bag export` and `bag import`."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from ctrl_rl_core.command import FolderToWrite, checked, finite_number
from tqdm import tqdm

from ctrl_rl_bags.datasets.conversion import Converted, count_messages, export_bags, import_dataset
from ctrl_rl_bags.datasets.options import DriveOptions, print_note
from ctrl_rl_core import load_navigation_task


def _period(text: str) -> float:
    value = finite_number(text)
    if value <= 0.0:
        raise ValueError(f"'{text}' must be above 0")
    return value


@dataclass(frozen=True, kw_only=True)
class Export(DriveOptions):
    """Export the drives of bags as a dataset for LeRobot (version 3) or Minari."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN ...]")]
    """Bags, or folders of runs with a bag in `bag`."""
    format: Literal["lerobot", "minari"]
    """Library that will read the dataset."""
    output: Annotated[FolderToWrite, tyro.conf.arg(aliases=["-o"])]
    """Folder of the dataset, which must not exist."""
    image: str = "camera/image_raw"
    """Topic of the camera (sensor_msgs/Image); without it the dataset has no images."""
    task: str = ""
    """Task of the drives, one of the suite or a task file, for the environment of a Minari dataset.

    By default from the bag's parameters. Any other name is stored as is.
    """
    period: Annotated[float | None, checked(_period, "NUMBER")] = None
    """Time between frames [s]; by default one frame per scan, and for Minari the task's time step, if known."""


@dataclass(frozen=True, kw_only=True)
class Import:
    """Convert a dataset written by `bag export` back to bags, one per original bag."""

    dataset: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DATASET")]
    """Folder of the dataset."""
    output: Annotated[FolderToWrite, tyro.conf.arg(aliases=["-o"])]
    """Folder of the bags, which must not exist."""
    robot: str = ""
    """Namespace of the topics."""


def run_export(options: Export) -> int:
    """Run `bag export` and return its exit code."""
    began = time.monotonic()
    file = Path(options.task)
    named = load_navigation_task(file) if file.suffix in (".yaml", ".yml") else None
    name = options.task if named is None else named.name
    how = options.extraction(image=options.image, task=name, period=options.period)
    environment = None if named is None else (named, str(file.resolve()))
    with tqdm(total=count_messages(options.runs), desc="export", unit="message", disable=None) as bar:
        found = export_bags(options.runs, options.output, options.format, how, bar.update, environment)
    left_out = f"{found.left_out} scans are in no frame: no odometry or command with them"
    for line in (*found.missing, *([left_out] if found.left_out else [])):
        print_note("bag export", line)
    if (delay := float(np.nanmedian(found.delays))) >= 0.0:
        print(f"commands come {delay:.3f} s after their scan")
    _report(found, options.output, began)
    return 0


def run_import(options: Import) -> int:
    """Run `bag import` and return its exit code."""
    began = time.monotonic()
    _report(import_dataset(options.dataset, options.output, options.robot), options.output, began)
    return 0


def _report(found: Converted, output: Path, began: float) -> None:
    seconds = time.monotonic() - began
    size = found.bytes * 1e-6
    print(f"{found.episodes} episodes, {found.frames} frames of {size:.1f} MB of messages in {seconds:.1f} s")
    print(f"written    {output}")
