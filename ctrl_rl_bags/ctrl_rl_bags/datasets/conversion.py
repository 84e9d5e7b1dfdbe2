"""Conversion from bags to datasets and back: `ros2 run ctrl_rl_bags bag export` and `bag import`."""

from __future__ import annotations

import importlib
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
from ctrl_rl_core.io import raise_as, temporary_beside

from ctrl_rl_bags.alignment.resampling import even
from ctrl_rl_bags.datasets.extraction import Found, extract, find_layout
from ctrl_rl_bags.datasets.frames import DatasetError, Frames, Layout, read_own_info
from ctrl_rl_bags.datasets.options import TASK_DIGEST, ExtractionOptions
from ctrl_rl_bags.datasets.rebuilding import rebuild
from ctrl_rl_bags.format.checks import reason
from ctrl_rl_bags.format.metadata import METADATA_FILE
from ctrl_rl_bags.format.reader import bag_info
from ctrl_rl_core import NavigationTask, load_task, task_digest, task_names

FORMATS: Mapping[str, tuple[str, str]] = {
    "lerobot": ("meta/info.json", "pyarrow"),
    "minari": ("data/metadata.json", "h5py"),
}
"""Description file of a dataset and package required by the module `<name>_format`, by format name."""
_LONGEST_NAME = 200


class Converted(NamedTuple):
    """Result of a conversion.

    Counts of episodes, frames, bytes read and scans in no frame, and lines on missing content; `delays` are the times
    from scans to commands, one per bag [s].
    """

    episodes: int
    frames: int
    bytes: int
    left_out: int
    missing: tuple[str, ...]
    delays: Sequence[float] = ()


def export_bags(
    runs: Sequence[Path],
    output: Path,
    kind: str,
    options: ExtractionOptions,
    tell: Callable[[int], object] = lambda _: None,
    environment: tuple[NavigationTask, str] | None = None,
) -> Converted:
    """Export the drives of bags as a dataset for another library.

    Args:
        runs: Bags, or folders of runs with a bag in `bag`.
        output: Folder of the dataset, which must not exist.
        kind: One of `FORMATS`.
        options: Topic names, and beams of the scans.
        tell: Called with the number of messages read since the last call.
        environment: Task of the drives and its file, for formats that name their environment; by default the suite's
            task named in the bags.

    Raises:
        BagError: A bag cannot be read, has no drive, or does not fit the first; the output exists.
    """
    bags = [find_bag(run) for run in runs]
    layout, found = find_layout(bags[0], options), Found()
    module = _module(kind)
    driven = _environment(layout, found.note) if environment is None else environment
    if kind == "minari" and driven is not None and options.period is None:
        step = driven[0].episode.time_step
        if not even(np.array([layout.period]), step).all():
            options = replace(options, period=step)
            layout = find_layout(bags[0], options)
            found.note(f"a frame is a step of the task, {step:g} s: --period keeps frames of another length")
    episodes = frames_written = 0
    with _new_folder(output) as folder:
        writer = module.Writer(folder, layout, output.name, driven)
        try:
            for frames in extract(bags, layout, options, found, tell):
                writer.write(frames)
                episodes += frames.last
                frames_written += len(frames)
            if not episodes:
                raise DatasetError(f"{bags[0]}: {found.why_nothing}")
            writer.close([str(run.name)[:_LONGEST_NAME] or "bag" for run in runs])
        finally:
            writer.abort()
    return Converted(
        episodes, frames_written, found.bytes, found.left_out, (*sorted(found.missing), *found.notes), found.delays
    )


def _environment(layout: Layout, tell: Callable[[str], object]) -> tuple[NavigationTask, str] | None:
    """Return the suite's task in which bags were recorded; None if unknown or recorded with another version."""
    task = load_task(layout.task) if layout.task in task_names() else None
    if not isinstance(task, NavigationTask):
        return None
    if layout.digests.get(TASK_DIGEST, task_digest(task)) != task_digest(task):
        tell(f"the bags were recorded in another version of the task '{task.name}': name its file with --task")
        return None
    return task, ""


def import_dataset(folder: Path, output: Path, robot: str = "") -> Converted:
    """Convert a dataset written by `export_bags` back to bags `output/bag_0`, `output/bag_1` ...

    Args:
        folder: Folder of the dataset.
        output: Folder of the bags, which must not exist.
        robot: Namespace of the topics.

    Raises:
        BagError: The folder is not such a dataset or is damaged, or the output exists.
    """
    layout, frames = read_dataset(folder)
    with _new_folder(output) as new, raise_as(DatasetError, folder):
        episodes, count, size = rebuild(frames, layout, new, robot)
    return Converted(episodes, count, size, 0, ())


def read_dataset(folder: Path) -> tuple[Layout, Iterator[Frames]]:
    """Return the layout of a dataset written by `export_bags`, and an iterator over its frames.

    Raises:
        DatasetError: The folder is not such a dataset.
    """
    kind = next((kind for kind, (info, _) in FORMATS.items() if (folder / info).is_file()), None)
    if kind is None:
        raise DatasetError(
            f"{folder} is no dataset: it has neither {' nor '.join(info for info, _ in FORMATS.values())}"
        )
    module = _module(kind)
    with raise_as(DatasetError, folder):
        layout = Layout.model_validate(read_own_info(folder / module.INFO).get("layout"))
    return layout, _frames_of(module, folder, layout)


def _frames_of(module: ModuleType, folder: Path, layout: Layout) -> Iterator[Frames]:
    try:
        yield from module.read_frames(folder, layout)
    except module.FAULTS as error:
        raise DatasetError(f"{module.CONTENT} cannot be read: {reason(error)}") from None


def find_bag(run: Path) -> Path:
    """Return the bag of a run: the folder itself, or its subfolder `bag`."""
    inner = run / "bag"
    return inner if run.is_dir() and not (run / METADATA_FILE).exists() and inner.is_dir() else run


def count_messages(runs: Sequence[Path]) -> int:
    """Return the total number of messages in the bags of runs."""
    return sum(bag_info(find_bag(run)).message_count for run in runs)


def _module(kind: str) -> ModuleType:
    try:
        return importlib.import_module(f"ctrl_rl_bags.datasets.{kind}_format")
    except ModuleNotFoundError:
        raise DatasetError(
            f"the format {kind} needs {FORMATS[kind][1]}: python -m pip install -r requirements/datasets.txt"
        ) from None


@contextmanager
def _new_folder(output: Path) -> Iterator[Path]:
    """Yield a temporary folder, which is renamed to `output` on success and removed otherwise."""
    if output.exists():
        raise DatasetError(f"{output} exists: name another folder")
    temporary = temporary_beside(output)
    temporary.mkdir(parents=True)
    try:
        yield temporary
        temporary.rename(output)
    except OSError as error:  # errors of a full disk, which each library words differently
        raise DatasetError(
            f"{output} cannot be written: {os.strerror(error.errno) if error.errno else error}"
        ) from None
    finally:
        with suppress(FileNotFoundError):
            shutil.rmtree(temporary)
