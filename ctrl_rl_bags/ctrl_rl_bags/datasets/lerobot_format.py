"""LeRobot datasets, version 3: Parquet files of frames, and metadata in JSON and Parquet.

Images are stored losslessly, as PNG files within the Parquet files. Layout and sources are in `meta/info.json` under
`ctrl_rl`.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from ctrl_rl_core.io import FileError, check_png, open_file
from ctrl_rl_core.processes import limited_memory
from numpy.typing import NDArray
from PIL import Image

from ctrl_rl_bags.datasets.frames import (
    IMAGE,
    IS_LAST,
    MEMORY,
    Column,
    DatasetError,
    Frames,
    Layout,
    own_info,
)
from ctrl_rl_bags.datasets.statistics import Statistics
from ctrl_rl_core import NavigationTask, atomic_write

INFO, TASKS, STATS = "meta/info.json", "meta/tasks.parquet", "meta/stats.json"
_EPISODES = "meta/episodes/chunk-000/file-000.parquet"
_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_FILE_MB, _CHUNK = 100, 1000
_ROWS = 1000
"""Rows per write; pieces with images are smaller."""
CONTENT, FAULTS = "its Parquet files", (pa.ArrowException, MemoryError, KeyError, TypeError, ValueError)
"""Description of the content, and exceptions that indicate damage."""
_COUNTERS = ("timestamp", "frame_index", "episode_index", "index", "task_index")


class Writer:
    """Writes one dataset to a folder.

    Args:
        folder: Folder of the dataset, which exists and is empty.
        layout: Layout of the frames.
        name: Name of the dataset, not stored in this format.
        environment: Task of the drives and its file, not stored in this format.
    """

    def __init__(
        self,
        folder: Path,
        layout: Layout,
        name: str,  # noqa: ARG002 - as all writers
        environment: tuple[NavigationTask, str] | None = None,  # noqa: ARG002
    ) -> None:
        self._folder, self._layout = folder, layout
        columns = layout.columns
        fields = [pa.field(name, _arrow_type(name, column)) for name, column in columns.items()]
        fields += [pa.field("timestamp", pa.float32()), *(pa.field(name, pa.int64()) for name in _COUNTERS[1:])]
        self._schema = pa.schema(fields)
        self._stats = {name: Statistics() for name, column in columns.items() if column.dtype != "bool"}
        self._file: pq.ParquetWriter | None = None
        self._file_index = -1
        self._index = self._frame_index = 0
        self._episodes: list[dict[str, Any]] = []
        self._waiting: list[pa.Table] = []

    def write(self, frames: Frames) -> None:
        """Append frames, episode by episode."""
        if self._frame_index == 0:
            self._begin_episode(frames)
        count = len(frames)
        rows = np.arange(count, dtype=np.int64)
        frame_index = self._frame_index + rows
        counters = {
            "timestamp": (frame_index / self._layout.rate).astype(np.float32),
            "frame_index": frame_index,
            "episode_index": np.full(count, frames.episode, dtype=np.int64),
            "index": self._index + rows,
            "task_index": np.zeros(count, dtype=np.int64),
        }
        arrays = [_arrow(name, values) for name, values in frames.columns.items()]
        arrays += [pa.array(counters[name]) for name in _COUNTERS]
        self._waiting.append(pa.Table.from_arrays(arrays, schema=self._schema))
        if sum(len(table) for table in self._waiting) >= _ROWS:
            self._flush()
        for name, stats in self._stats.items():
            values = frames.columns[name]
            stats.add(values if name != IMAGE else np.asarray(values, np.float32) / np.float32(255.0))
        self._index += count
        self._frame_index += count
        if frames.last:
            episode = self._episodes[-1]
            episode["length"], episode["dataset_to_index"] = self._frame_index, self._index
            self._frame_index = 0

    def close(self, sources: list[str]) -> None:
        """Finish the dataset; `sources` names the bags."""
        self._end_file()
        write_table(self._folder / _EPISODES, pa.Table.from_pylist(self._episodes))
        write_table(self._folder / TASKS, _tasks(self._layout.task))
        atomic_write(self._folder / STATS, json.dumps({name: each.summary() for name, each in self._stats.items()}))
        features = {name: _feature(name, column) for name, column in self._layout.columns.items()}
        features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
        features |= {name: {"dtype": "int64", "shape": [1], "names": None} for name in _COUNTERS[1:]}
        rate = self._layout.rate
        info = {
            "codebase_version": "v3.0",
            "robot_type": "quadrotor" if "Rotor" in self._layout.command else "differential_drive",
            "total_episodes": len(self._episodes),
            "total_frames": self._index,
            "total_tasks": 1,
            "chunks_size": _CHUNK,
            "data_files_size_in_mb": _FILE_MB,
            "video_files_size_in_mb": 200,
            "fps": int(rate) if rate == int(rate) else rate,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": _DATA,
            "video_path": None,
            "features": features,
            **own_info(self._layout, sources),
        }
        atomic_write(self._folder / INFO, json.dumps(info, indent=1))

    def abort(self) -> None:
        """Close the open file."""
        if self._file is not None:
            self._file.close()

    def _begin_episode(self, frames: Frames) -> None:
        path = self._path()
        if self._file is None or path.stat().st_size > _FILE_MB << 20:
            self._end_file()
            self._file_index += 1
            path = self._path()
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = pq.ParquetWriter(path, self._schema, compression="snappy")
        chunk, file = divmod(self._file_index, _CHUNK)
        self._episodes.append(
            {
                "episode_index": frames.episode,
                "tasks": [self._layout.task],
                "length": 0,
                "data/chunk_index": chunk,
                "data/file_index": file,
                "dataset_from_index": self._index,
                "dataset_to_index": self._index,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                "source": frames.source,
            }
        )

    def _flush(self) -> None:
        if self._file is not None and self._waiting:
            self._file.write_table(pa.concat_tables(self._waiting))
            self._waiting = []

    def _end_file(self) -> None:
        self._flush()
        if self._file is not None:
            self._file.close()

    def _path(self) -> Path:
        chunk, file = divmod(max(self._file_index, 0), _CHUNK)
        return self._folder / _DATA.format(chunk_index=chunk, file_index=file)


def read_frames(folder: Path, layout: Layout) -> Iterator[Frames]:
    """Yield a dataset's frames, a piece of an episode at a time; raise DatasetError or one of `FAULTS`."""
    with _opened(folder / _EPISODES) as file:
        episodes = file.read(columns=["episode_index", "source"]).to_pylist()
    sources = {int(row["episode_index"]): int(row["source"]) for row in episodes}
    columns = layout.columns
    for path in sorted((folder / "data").glob("chunk-*/file-*.parquet")):
        with _opened(path) as file:
            missing = {*columns, "episode_index"} - set(file.schema_arrow.names)
            if missing:
                raise DatasetError(f"{path.name} has no column {min(missing)}")
            for batch in file.iter_batches(batch_size=1000, columns=[*columns, "episode_index"]):
                numbers = batch.column("episode_index").to_numpy(zero_copy_only=False)
                for rows in np.split(np.arange(len(numbers)), np.flatnonzero(np.diff(numbers)) + 1):
                    part = batch.slice(int(rows[0]), len(rows))
                    arrays = {name: _numpy(name, part.column(name), column) for name, column in columns.items()}
                    number = int(numbers[rows[0]])
                    yield Frames(arrays, number, sources.get(number, 0), bool(arrays[IS_LAST][-1]))


@contextmanager
def _opened(path: Path) -> Iterator[pq.ParquetFile]:
    """Open a Parquet file under a memory limit, because a short file can unfold to gigabytes."""
    # Arrow's pool reserves a gigabyte of addresses with its first allocation: all that the limit would allow.
    pa.array([0.0])
    with open_file(path, math.inf) as (stream, size), limited_memory(MEMORY + 8 * size), pq.ParquetFile(stream) as file:
        yield file


def write_table(path: Path, table: pa.Table) -> None:
    """Write a small table as a Parquet file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path, compression="snappy")


def _tasks(task: str) -> pa.Table:
    """Return the table of tasks, indexed by name as in pandas."""
    index, plain = "__index_level_0__", {"metadata": None}
    column = {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64", **plain}
    name = {"name": None, "field_name": index, "pandas_type": "unicode", "numpy_type": "object", **plain}
    told = {"index_columns": [index], "column_indexes": [], "columns": [column, name], "pandas_version": "2.0.0"}
    schema = pa.schema([("task_index", pa.int64()), (index, pa.string())], {b"pandas": json.dumps(told).encode()})
    return pa.Table.from_arrays([pa.array([0], pa.int64()), pa.array([task])], schema=schema)


def _feature(name: str, column: Column) -> dict[str, Any]:
    names = column.names
    told = [f"{names}_{index}" for index in range(column.shape[0])] if isinstance(names, str) else list(names)
    return {
        "dtype": "image" if name == IMAGE else column.dtype,
        "shape": list(column.shape or (1,)),
        "names": told or None,
    }


def _arrow_type(name: str, column: Column) -> pa.DataType:
    if name == IMAGE:
        return pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    plain = pa.bool_() if column.dtype == "bool" else pa.from_numpy_dtype(np.dtype(column.dtype))
    return pa.list_(plain, math.prod(column.shape)) if column.shape and column.shape != (1,) else plain


def _arrow(name: str, values: NDArray[np.generic]) -> pa.Array:
    if name == IMAGE:
        return pa.array([{"bytes": _png(picture), "path": None} for picture in values])
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    return (
        flat if values.ndim == 1 or values.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    )


def _numpy(name: str, array: pa.Array, column: Column) -> NDArray[np.generic]:
    if name == IMAGE:
        pictures = [_picture(entry["bytes"], column.shape) for entry in array.to_pylist()]
        return np.array(pictures, dtype=np.uint8).reshape(len(pictures), *column.shape)
    if array.null_count or not array.type.equals(_arrow_type(name, column)):
        raise DatasetError(f"column {name} is {array.type}: must be {_arrow_type(name, column)}, without gaps")
    flat = array.flatten() if isinstance(array, pa.FixedSizeListArray) else array
    if flat.null_count:
        raise DatasetError(f"column {name} has gaps")
    return np.asarray(flat.to_numpy(zero_copy_only=False)).reshape(len(array), *column.shape)


def _png(picture: NDArray[np.uint8]) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def _picture(content: Any, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    try:
        check_png(io.BytesIO(content))
        with Image.open(io.BytesIO(content), formats=("PNG",)) as picture:
            if (picture.height, picture.width) != shape[:2]:
                raise DatasetError(f"a picture has {picture.width} x {picture.height} pixels, not as the layout says")
            return np.asarray(picture.convert("RGB"), dtype=np.uint8)
    except (FileError, OSError, TypeError, ValueError, SyntaxError):
        raise DatasetError("an image is not a PNG file") from None
