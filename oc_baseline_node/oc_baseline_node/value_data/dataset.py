"""Value data: a folder with chunks of solved trajectories and their values (thesis Eq. 3.13).

Reading the data needs no solver; `oc_baseline_node.value_data.workers` generates it.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from ctrl_rl_core.io import (
    FileError,
    Name,
    Number,
    Schema,
    Sha256,
    encode_arrays,
    is_temporary,
    raise_as,
    read_arrays,
    read_json,
    with_digest,
)
from numpy.typing import NDArray
from pydantic import Field

from ctrl_rl_core import atomic_write
from oc_baseline_node.errors import OcError
from oc_baseline_node.problems.problem import OptimalControlProblem
from oc_baseline_node.values.returns import returns, rewards, step_discount

Array = NDArray[np.float64]
FORMAT = "oc-value-data-1"
LOCK = ".lock"
"""File in a value data folder that locks it against a second call."""
DOOMED = "cannot avoid a collision for one second, even without a goal"
"""Reason given for doomed starts."""
_NUMBER = re.compile(r"(?<![\w.])-?\d+(\.\d+)?(e[+-]?\d+)?(?![\w.])")
_LARGEST_CHUNK = 2_000_000_000
"""Maximum size of a chunk's arrays [bytes]."""
_KINDS = dict.fromkeys(("states", "controls", "time_steps", "cpu_seconds", "unsolved", "wasted_seconds"), "f") | {
    "reasons": "U",
    "doomed": "b",
}


class _Description(Schema):
    """Content of settings.json in a folder of value data."""

    format: Literal["oc-value-data-1"]
    task: Name
    task_digest: Sha256
    form: Name
    clearance: Number
    trajectories: Annotated[int, Field(ge=1, le=10_000_000)]
    chunk: Annotated[int, Field(ge=1, le=10_000_000)]
    seed: Annotated[int, Field(ge=0, le=2**63)]


@dataclass(frozen=True)
class DataSettings:
    """Settings that determine the value data.

    Attributes:
        trajectories: Number of solved trajectories.
        chunk: Number of trajectories per file.
        seed: Random seed of the starts, >= 0.

    Raises:
        OcError: There would be nothing to generate.
    """

    trajectories: int
    chunk: int = 10
    seed: int = 0

    def __post_init__(self) -> None:
        if self.trajectories < 1 or self.chunk < 1 or self.seed < 0:
            raise OcError(
                f"{self.trajectories} trajectories, {self.chunk} to a file, seed {self.seed}: the first two must be at "
                "least 1, the seed 0"
            )

    @property
    def chunks(self) -> int:
        """Number of chunks, one file each."""
        return -(-self.trajectories // self.chunk)

    def size(self, index: int) -> int:
        """Return the number of trajectories in chunk `index`."""
        return min(self.chunk, self.trajectories - index * self.chunk)


@dataclass(frozen=True)
class ValueData:
    """Solved trajectories, and starts without one.

    Attributes:
        states: States of the solved trajectories (N, H+1, n).
        controls: Controls of the solved trajectories (N, H, m).
        time_steps: Step durations of the solved trajectories (N,) [s].
        cpu_seconds: CPU time of each solved trajectory (N,) [s].
        unsolved: Starts without a trajectory (K, n).
        reasons: Status of the solver for each start without a trajectory.
        doomed: Whether the start cannot avoid obstacles and bounds for even one second (K,).
        wasted_seconds: CPU time spent on each start without a trajectory (K,) [s].
    """

    states: Array
    controls: Array
    time_steps: Array
    cpu_seconds: Array
    unsolved: Array
    reasons: tuple[str, ...]
    doomed: NDArray[np.bool_]
    wasted_seconds: Array

    @property
    def starts(self) -> int:
        """Number of random starts, with or without a trajectory."""
        return len(self.states) + len(self.unsolved)

    @property
    def dropped(self) -> dict[str, int]:
        """Number of starts without a trajectory by reason, the most frequent first; doomed ones count as one."""
        kinds = (DOOMED if hopeless else _NUMBER.sub("...", reason)
                 for reason, hopeless in zip(self.reasons, self.doomed, strict=True))  # fmt: skip
        return dict(Counter(kinds).most_common())

    @property
    def success_rate(self) -> float:
        """Fraction of random starts with a trajectory."""
        return len(self.states) / self.starts

    @property
    def success_rate_of_viable(self) -> float:
        """Fraction of starts with a trajectory among the non-doomed starts."""
        return len(self.states) / (len(self.states) + int(np.sum(~self.doomed)))

    def samples(
        self, problem: OptimalControlProblem, discount: float | None = None, whole_horizon: bool = False
    ) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return x_m as task states (N, H+1, n), V(x_m) by Eq. 3.13, and whether an episode visits it (N, H+1).

        An episode ends with its first goal, trap or collision; it does not visit later states of the trajectory.

        Args:
            problem: Optimal control problem of the task with the rewards.
            discount: Discount per policy step; the task's own by default.
            whole_horizon: Whether the sum continues after arrival to the end of the horizon, a possible reading of the
                thesis; every state then counts.
        """
        states = problem.task_states(self.states)
        paid, ended = rewards(problem.task, states)
        ended &= not whole_horizon
        over = np.logical_or.accumulate(ended, axis=1)
        met = np.column_stack((np.ones(len(over), dtype=bool), ~over[:, :-1]))
        per_step = step_discount(problem.task, problem.discount if discount is None else discount, self.time_steps)
        return states, returns(paid, ended, per_step), met


def description(problem: OptimalControlProblem, settings: DataSettings) -> dict[str, Any]:
    """Return the description of value data; data with other settings needs another folder."""
    return {
        "format": FORMAT,
        "task": problem.task.name,
        "task_digest": problem.digest,
        "form": problem.form,
        "clearance": problem.clearance,
        "trajectories": settings.trajectories,
        "chunk": settings.chunk,
        "seed": settings.seed,
    }


def chunk_file(folder: Path, index: int) -> Path:
    """Return the path of a chunk's file."""
    return folder / f"chunk-{index:04d}.npz"


def write_chunk(folder: Path, index: int, data: ValueData) -> None:
    """Write a chunk atomically.

    Raises:
        OSError: The file cannot be written.
    """
    arrays: dict[str, Any] = {name: getattr(data, name) for name in ValueData.__annotations__}
    arrays["reasons"] = np.array(data.reasons, dtype=np.str_)
    atomic_write(chunk_file(folder, index), encode_arrays(arrays))


def make_folder(folder: Path) -> None:
    """Create a folder for value data unless it exists.

    Raises:
        OcError: The folder has other content, apart from leftovers of a killed call.
        OSError: The folder cannot be created.
    """
    folder.mkdir(parents=True, exist_ok=True)
    other = [file for file in folder.iterdir() if file.name != LOCK and not is_temporary(file)]
    if other and not (folder / "settings.json").exists():
        raise OcError(f"{folder} holds {other[0].name}, which is no value data: give another folder")


def open_folder(folder: Path, problem: OptimalControlProblem, settings: DataSettings) -> list[int]:
    """Start or continue value data in a folder of `make_folder`; return the indices of the missing chunks.

    The caller must hold the folder's lock, because partial files of a killed call are removed.

    Raises:
        OcError: The folder has data with other settings.
        OSError: The folder cannot be written to.
    """
    file = folder / "settings.json"
    if file.exists():
        _check_same(folder, problem, settings)
    for left in filter(is_temporary, folder.iterdir()):
        left.unlink()
    if not file.exists():
        atomic_write(file, json.dumps(with_digest(description(problem, settings)), indent=1) + "\n")
    return _lacking(folder, settings)


def _check_same(folder: Path, problem: OptimalControlProblem, settings: DataSettings) -> None:
    there = read_description(folder)
    for name, wanted in description(problem, settings).items():
        if there.get(name) != wanted:
            raise OcError(f"{folder} holds data with {name} = {there.get(name)}, not {wanted}: give another folder")


def _lacking(folder: Path, settings: DataSettings) -> list[int]:
    return [index for index in range(settings.chunks) if not chunk_file(folder, index).exists()]


def read_description(folder: Path) -> dict[str, Any]:
    """Read the description of a value data folder.

    Raises:
        OcError: The description is missing or invalid.
    """
    file = folder / "settings.json"
    if not file.is_file():
        raise OcError(f"{folder} has no value data: generate it with 'oc data'")
    with raise_as(OcError, file, "generate the data again in another folder"):
        return _Description.model_validate(read_json(file)).model_dump()


def load_data(folder: Path, problem: OptimalControlProblem) -> ValueData:
    """Read a whole folder of value data.

    Raises:
        OcError: The data belongs to another problem, or a chunk is missing or unreadable.
    """
    there = read_description(folder)
    settings = DataSettings(*(int(there[name]) for name in ("trajectories", "chunk", "seed")))
    _check_same(folder, problem, settings)
    lacking = _lacking(folder, settings)
    if lacking:
        raise OcError(f"{folder} lacks {len(lacking)} of {settings.chunks} chunks: run the same 'oc data' again")
    return join([_read_chunk(chunk_file(folder, index)) for index in range(settings.chunks)])


def join(parts: list[ValueData]) -> ValueData:
    """Concatenate chunks."""
    names = [name for name in ValueData.__annotations__ if name != "reasons"]
    arrays: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return ValueData(reasons=tuple(reason for part in parts for reason in part.reasons), **arrays)


def _read_chunk(file: Path) -> ValueData:
    with raise_as(OcError, file, "delete it and run 'oc data' again"):
        arrays: dict[str, Any] = read_arrays(file, tuple(ValueData.__annotations__), _LARGEST_CHUNK)
        sizes = {name: array.shape for name, array in arrays.items()}
        solved, unsolved = sizes["states"][:1], sizes["unsolved"][:1]
        fits = (
            [len(sizes[name]) for name in ("states", "controls", "unsolved")] == [3, 3, 2]
            and sizes["controls"][:2] == (solved[0], sizes["states"][1] - 1)
            and sizes["unsolved"][1] == sizes["states"][2]
            and sizes["time_steps"] == sizes["cpu_seconds"] == solved
            and sizes["reasons"] == sizes["doomed"] == sizes["wasted_seconds"] == unsolved
        )
        if not fits or any(arrays[name].dtype.kind != kind for name, kind in _KINDS.items()):
            raise FileError("its arrays do not fit each other")
    return ValueData(**{**arrays, "reasons": tuple(arrays["reasons"].tolist())})
