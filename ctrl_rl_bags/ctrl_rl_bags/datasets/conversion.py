"""Bags to datasets and back: `ros2 run ctrl_rl_bags bag export` and `bag import`."""

from __future__ import annotations

import importlib
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from ctrl_rl_core.io import raise_as, temporary_beside

from ctrl_rl_bags.datasets.extraction import Found, extract, find_layout
from ctrl_rl_bags.datasets.frames import DatasetError, Frames, Layout, read_own_info
from ctrl_rl_bags.datasets.options import ExtractionOptions
from ctrl_rl_bags.datasets.rebuilding import rebuild
from ctrl_rl_bags.format.checks import reason
from ctrl_rl_bags.format.metadata import METADATA_FILE
from ctrl_rl_bags.format.reader import bag_info

FORMATS: Mapping[str, tuple[str, str]] = {
    "lerobot": ("meta/info.json", "pyarrow"),
    "minari": ("data/metadata.json", "h5py"),
}
"""By name, the file that describes a dataset, and the package that the module `<name>_format` needs."""
_LONGEST_NAME = 200


class Converted(NamedTuple):
    """What was written: episodes, frames, bytes of messages read, scans in no frame, and lines on what is missing.

    `delays` are the times from scans to commands, one per bag [s].
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
) -> Converted:
    """Export the drives of bags as a dataset of another library.

    Args:
        runs: Bags, or folders of runs with a bag in `bag`.
        output: Folder of the dataset, which must not exist.
        kind: One of `FORMATS`.
        options: Names of the topics, and beams of the scans.
        tell: Called with the number of messages read since the last call.

    Raises:
        BagError: A bag cannot be read, has no drive, or does not fit the first; the output exists.
    """
    bags = [find_bag(run) for run in runs]
    layout, found = find_layout(bags[0], options), Found()
    module = _module(kind)
    episodes = frames_written = 0
    with _new_folder(output) as folder:
        writer = module.Writer(folder, layout, output.name)
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


def import_dataset(folder: Path, output: Path, robot: str = "") -> Converted:
    """Turn a dataset that `export_bags` wrote back into bags `output/bag_0`, `output/bag_1` ...

    Args:
        folder: Folder of the dataset.
        output: Folder of the bags, which must not exist.
        robot: Namespace of the topics.

    Raises:
        BagError: It is not such a dataset, it is damaged, or the output exists.
    """
    layout, frames = read_dataset(folder)
    with _new_folder(output) as new, raise_as(DatasetError, folder):
        episodes, count, size = rebuild(frames, layout, new, robot)
    return Converted(episodes, count, size, 0, ())


def read_dataset(folder: Path) -> tuple[Layout, Iterator[Frames]]:
    """Return the layout of a dataset that `export_bags` wrote, and a stream of its frames.

    Raises:
        DatasetError: It is not such a dataset.
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
    """Return the bag of a run: the folder itself, or its `bag`."""
    inner = run / "bag"
    return inner if run.is_dir() and not (run / METADATA_FILE).exists() and inner.is_dir() else run


def count_messages(runs: Sequence[Path]) -> int:
    """Return the number of messages of the bags of runs."""
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
    """Yield a temporary folder; rename it to `output` on success, else remove it."""
    if output.exists():
        raise DatasetError(f"{output} exists: name another folder")
    temporary = temporary_beside(output)
    temporary.mkdir(parents=True)
    try:
        yield temporary
        temporary.rename(output)
    except OSError as error:  # of a full disk, which each library words in another way
        raise DatasetError(
            f"{output} cannot be written: {os.strerror(error.errno) if error.errno else error}"
        ) from None
    finally:
        with suppress(FileNotFoundError):
            shutil.rmtree(temporary)
