"""Minari datasets: one HDF5 file of episodes, and metadata in JSON.

An episode has one more observation than actions and rewards; `infos` has the times and outcomes of all observations.
Layout and sources are in `metadata.json` under `ctrl_rl`. If the task is known, `env_spec` names its environment,
observations, actions and rewards are those of the environment, and `infos` has the frames as recorded.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from ctrl_rl_core.io import open_file
from ctrl_rl_core.processes import limited_memory
from numpy.typing import NDArray

from ctrl_rl_bags.datasets.frames import (
    ACTION,
    DONE,
    IS_LAST,
    LOG_TIME,
    MEMORY,
    ODOMETRY,
    OUTCOME,
    REWARD,
    STAMP,
    Column,
    DatasetError,
    Frames,
    Layout,
    own_info,
)
from ctrl_rl_bags.datasets.task_view import TaskView, environment_spec
from ctrl_rl_core import NavigationTask, atomic_write

INFO, DATA = "data/metadata.json", "data/main_data.hdf5"
VERSION = "0.5.4"
"""Version of Minari that defines this format."""
CONTENT, FAULTS = DATA, (MemoryError, OSError, RuntimeError, KeyError, TypeError, ValueError)
"""Description of the content, and exceptions that indicate damage."""
_OBSERVATION = "observation."
_INFOS = (STAMP, LOG_TIME, OUTCOME)
_OF_STEPS = ("actions", "rewards")
_VERSION = re.compile(r"-v\d+$")
_Columns = Mapping[str, NDArray[Any]]
Array = NDArray[np.float64]
_ONES = np.ones(2, np.float32)
_PIECE = 1000
_MOST_EPISODES = 10_000_000


class _Disk(io.FileIO):
    """A file that accepts every write, because HDF5 ends the process when it closes a file after a failed write.

    Attributes:
        failure: First failed write, raised by `raise_failure`.
    """

    failure: OSError | None = None

    def write(self, data: Any) -> int:
        """Write, or record the failure."""
        view = memoryview(data).cast("B")
        try:
            done = 0
            while done < len(view):
                done += super().write(view[done:]) or 0
        except OSError as error:
            self.failure = self.failure or error
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the size, or record the failure."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.failure = self.failure or error
        return size or 0

    def raise_failure(self) -> None:
        """Raise the first failure.

        Raises:
            OSError: A write has failed.
        """
        if self.failure is not None:
            raise self.failure


class Writer:
    """Writes one dataset to a folder.

    Args:
        folder: Folder of the dataset, which exists and is empty.
        layout: Layout of the frames.
        name: Name of the dataset, as in `mine` or `mine-v0`.
        environment: Task of the drives and its file; None if unknown.

    Raises:
        PolicyError: The task's commands cannot be sent by a node.
    """

    def __init__(
        self, folder: Path, layout: Layout, name: str, environment: tuple[NavigationTask, str] | None = None
    ) -> None:
        self._folder, self._layout = folder, layout
        self._name = name if _VERSION.search(name) else f"{name}-v0"
        self._environment = environment
        self._view = None if environment is None else TaskView(environment[0], layout)
        self._before: Array | None = None
        (folder / DATA).parent.mkdir(parents=True)
        self._disk = _Disk(folder / DATA, "w+")
        self._file = h5py.File(self._disk, "w", track_order=True)
        self._group: h5py.Group | None = None
        self._episodes = self._steps = 0

    def write(self, frames: Frames) -> None:
        """Append frames, episode by episode."""
        if self._group is None:
            self._group = self._file.create_group(f"episode_{frames.episode}", track_order=True)
            self._group.attrs.update({"id": frames.episode, "source": frames.source})
        group, columns = self._group, frames.columns
        whole = frames.last and "rewards" not in group
        done = ~np.asarray(columns[IS_LAST], dtype=np.bool_)
        outcomes, terminated = columns[OUTCOME][done], columns[DONE][done]
        ended = np.zeros(len(outcomes), dtype=np.bool_)
        if frames.last:
            ended[-1:] = True
        for name, values in (
            *(self._recorded(columns, done) if self._view is None else self._seen(self._view, columns, done)).items(),
            ("terminations", terminated),
            ("truncations", ended & ~np.asarray(terminated, dtype=np.bool_)),
            *((f"infos/{name}", columns[name]) for name in _INFOS),
        ):
            _append(group, name, values, whole)
        self._before = None if frames.last else np.asarray(columns[ACTION], np.float64)[-1]
        self._steps += len(outcomes)
        if frames.last:
            group.attrs["total_steps"] = len(group["rewards"])
            self._episodes += 1
            self._group = None
        self._disk.raise_failure()

    def _recorded(self, columns: _Columns, done: NDArray[np.bool_]) -> _Columns:
        """Return the arrays of frames of an unknown task, as recorded."""
        out = {_place(name): values for name, values in columns.items() if name.startswith(_OBSERVATION)}
        return out | {"actions": columns[ACTION][done], "rewards": columns[REWARD][done]}

    def _seen(self, view: TaskView, columns: _Columns, done: NDArray[np.bool_]) -> _Columns:
        """Return the arrays of frames in the form of the task's environment, and as recorded."""
        outcomes = np.asarray(columns[OUTCOME][done], np.int64)
        running = np.asarray(columns[REWARD][done], np.float64) if self._layout.reward else 0.0
        seen, _ = view.observe(columns, self._before)
        recorded = {f"infos/{name}": columns[name] for name in columns if name not in (*_INFOS, DONE, IS_LAST)}
        return {
            "observations": seen,
            "actions": view.actions(np.asarray(columns[ACTION][done], np.float64)),
            "rewards": np.where(outcomes == 0, running, view.paid(outcomes)),
            **recorded,
        }

    def close(self, sources: list[str]) -> None:
        """Finish the dataset; `sources` names the bags."""
        self._file.close()
        self._disk.close()
        self._disk.raise_failure()
        observations, actions = self._spaces()
        specified = {} if self._environment is None else {"env_spec": environment_spec(*self._environment)}
        metadata = {
            "total_episodes": self._episodes,
            "total_steps": self._steps,
            "data_format": "hdf5",
            "jpeg_encoding": False,
            "observation_space": json.dumps(observations),
            "action_space": json.dumps(actions),
            **specified,
            "dataset_id": self._name,
            "minari_version": VERSION,
            "description": f"Drives of task {self._layout.task}, from bags.",
            "dataset_size": round((self._folder / DATA).stat().st_size / 1e6, 1),
            **own_info(self._layout, sources),
        }
        atomic_write(self._folder / INFO, json.dumps(metadata, indent=1))

    def _spaces(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the spaces of observations and actions."""
        if self._view is not None:
            parts = self._view.interface.observation
            low, high = (np.concatenate([part.spread(name) for part in parts]) for name in ("low", "high"))
            return _box("float32", low.astype(np.float32), high.astype(np.float32)), _box("float32", -_ONES, _ONES)
        columns = self._layout.columns
        spaces = {
            name.removeprefix(_OBSERVATION): _space(column)
            for name, column in columns.items()
            if name.startswith(_OBSERVATION)
        }
        return {"type": "Dict", "subspaces": spaces}, _space(columns[ACTION])

    def abort(self) -> None:
        """Close the open file."""
        with suppress(OSError, RuntimeError):  # raised for an incomplete file
            self._file.close()
        self._disk.close()


def read_frames(folder: Path, layout: Layout) -> Iterator[Frames]:
    """Yield a dataset's frames, a piece of an episode at a time; raise DatasetError or one of `FAULTS`."""
    with open_file(folder / DATA, math.inf) as (_, size):  # rejects a pipe, which would block
        pass
    with limited_memory(MEMORY + 2 * size), h5py.File(folder / DATA, "r") as file:
        for number in range(min(len(file), _MOST_EPISODES)):
            group = _member(file, f"episode_{number}", h5py.Group)
            source = int(group.attrs.get("source", 0))
            stored = {name: column for name, column in layout.columns.items() if name not in (DONE, IS_LAST)}
            seen = f"infos/{ODOMETRY}" in group  # observations are then those of the environment
            places = {name: f"infos/{name}" if seen else _place(name) for name in stored}
            arrays = {name: _array(group, places[name], column) for name, column in stored.items()}
            length = len(arrays[STAMP])
            for name, array in arrays.items():
                wanted = length - 1 if places[name] in _OF_STEPS else length
                if len(array) != wanted or length < 2:
                    raise DatasetError(f"episode {number} has {len(array)} rows of {name} at {length} times")
            for first in range(0, length, _PIECE):
                yield _frames(arrays, layout, first, min(first + _PIECE, length), length, number, source)


def _frames(
    arrays: Mapping[str, h5py.Dataset], layout: Layout, first: int, end: int, length: int, number: int, source: int
) -> Frames:
    last = end == length
    columns: dict[str, NDArray[np.generic]] = {name: array[first:end] for name, array in arrays.items()}
    if last and len(arrays[ACTION]) < length:  # the last action repeats the previous one, and its reward is unknown
        columns[ACTION] = np.concatenate((columns[ACTION], arrays[ACTION][length - 2 : length - 1]))
        columns[REWARD] = np.append(columns[REWARD], np.nan)
    outcomes = columns[OUTCOME]
    columns[DONE] = (outcomes != 0) & (outcomes != 4)
    columns[IS_LAST] = np.arange(first, end) == length - 1
    return Frames({name: columns[name] for name in layout.columns}, number, source, last)


def _place(name: str) -> str:
    """Return the path of a frame's column in a dataset of an unknown task."""
    observed = name.startswith(_OBSERVATION)
    place = f"observations/{name.removeprefix(_OBSERVATION)}" if observed else f"infos/{name}"
    return {ACTION: "actions", REWARD: "rewards"}.get(name, place)


def _array(group: h5py.Group, place: str, column: Column) -> h5py.Dataset:
    *path, leaf = place.split("/")
    for part in path:
        group = _member(group, part, h5py.Group)
    array = _member(group, leaf, h5py.Dataset)
    if array.external or array.is_virtual:
        raise DatasetError(f"{array.name} is stored in another file, which is not read")
    if array.dtype != np.dtype(column.dtype) or array.shape[1:] != column.shape or array.ndim < 1:
        raise DatasetError(f"{array.name} is {array.dtype} of shape {array.shape}, which is not what the layout says")
    return array


def _member(group: h5py.Group, name: str, kind: type) -> Any:
    """Return a member of a group, which must be stored in the same file."""
    if not isinstance(group.get(name, getlink=True), h5py.HardLink) or not isinstance(group[name], kind):
        raise DatasetError(f"has no {group.name.rstrip('/')}/{name}")
    return group[name]


def _append(group: h5py.Group, name: str, values: NDArray[np.generic], whole: bool) -> None:
    """Append rows to an array, or create it at once if the rows are the `whole` array."""
    if whole:
        group.create_dataset(name, data=values)
        return
    if name not in group:
        rows = max(1, min(_PIECE, 65536 // max(1, values[:1].nbytes)))
        chunks = (rows, *values.shape[1:])
        group.create_dataset(name, data=values, maxshape=(None, *values.shape[1:]), chunks=chunks)
        return
    array = group[name]
    array.resize(len(array) + len(values), axis=0)
    array[len(array) - len(values) :] = values


def _space(column: Column) -> dict[str, Any]:
    shape = column.shape or (1,)
    low, high = (0, 255) if column.dtype == "uint8" else (-np.inf, np.inf)
    return _box(column.dtype, np.full(shape, low), np.full(shape, high))


def _box(dtype: str, low: NDArray[Any], high: NDArray[Any]) -> dict[str, Any]:
    return {"type": "Box", "dtype": dtype, "shape": list(low.shape), "low": low.tolist(), "high": high.tolist()}
