"""The commands `bag export` and `bag import`."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from ctrl_rl_core.command import FolderToWrite, at_least
from tqdm import tqdm

from ctrl_rl_bags.datasets.conversion import Converted, count_messages, export_bags, import_dataset
from ctrl_rl_bags.datasets.wiring import ExtractionOptions


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write the drives of bags as a dataset of LeRobot (version 3) or Minari."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN ...]")]
    """Bags, or folders of runs with a bag in `bag`."""
    format: Literal["lerobot", "minari"]
    """Library that is to read the dataset."""
    output: Annotated[FolderToWrite, tyro.conf.arg(aliases=["-o"])]
    """Folder of the dataset, which must not exist."""
    robot: str = ""
    """Namespace of the topics."""
    image: str = "camera/image_raw"
    """Topic of the camera's pictures (sensor_msgs/Image); without such a topic there are none."""
    task: str = ""
    """Name of the task (default: what the bag's parameters say)."""
    beams: at_least(1) | None = None  # type: ignore[valid-type]
    """Number of beams that all scans are brought to, for lidars whose scans differ (default: as they are)."""


@dataclass(frozen=True, kw_only=True)
class Import:
    """Write a dataset that `bag export` wrote as bags again, one for each that it came from."""

    dataset: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DATASET")]
    """Folder of the dataset."""
    output: Annotated[FolderToWrite, tyro.conf.arg(aliases=["-o"])]
    """Folder of the bags, which must not exist."""
    robot: str = ""
    """Namespace of the topics."""


def run_export(options: Export) -> int:
    """Do what `bag export` is asked to and return the exit code."""
    began = time.monotonic()
    how = ExtractionOptions(options.robot, options.image, options.task, options.beams)
    with tqdm(total=count_messages(options.runs), desc="export", unit="message", disable=None) as bar:
        found = export_bags(options.runs, options.output, options.format, how, bar.update)
    for reason in found.missing:
        print(f"bag export: {reason}", file=sys.stderr)
    if found.left_out:
        print(f"bag export: {found.left_out} scans are in no frame: no odometry or command with them", file=sys.stderr)
    _report(found, options.output, began)
    return 0


def run_import(options: Import) -> int:
    """Do what `bag import` is asked to and return the exit code."""
    began = time.monotonic()
    _report(import_dataset(options.dataset, options.output, options.robot), options.output, began)
    return 0


def _report(found: Converted, output: Path, began: float) -> None:
    seconds = time.monotonic() - began
    size = found.bytes * 1e-6
    print(f"{found.episodes} episodes, {found.frames} frames of {size:.1f} MB of messages in {seconds:.1f} s")
    print(f"written    {output}")
