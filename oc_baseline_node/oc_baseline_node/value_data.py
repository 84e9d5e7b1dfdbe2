"""Value data: a folder of chunks, each some solved trajectories, and their values (thesis Eq. 3.13).

Reading them needs no solver; `oc_baseline_node.chunk_solver` makes them.
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.whole_file import is_temporary, write_whole
from numpy.typing import NDArray

from oc_baseline_node.errors import OcError
from oc_baseline_node.problem import Problem
from oc_baseline_node.returns import returns, rewards, step_discount

Array = NDArray[np.float64]
FORMAT = "oc-value-data-1"
LOCK = ".lock"
"""File of a folder of value data that keeps a second call out."""
_TYPES: dict[str, type | tuple[type, ...]] = {
    "task": str,
    "task_digest": str,
    "form": str,
    "clearance": (int, float),
    "trajectories": int,
    "chunk": int,
    "seed": int,
}
"""Of what a folder of value data says about itself."""


@dataclass(frozen=True)
class DataSettings:
    """What value data depend on.

    Attributes:
        trajectories: how many solved ones.
        chunk: of them to a file.
        seed: of the starts, zero or more.

    Raises:
        OcError: there would be nothing to make.
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
        """How many files."""
        return -(-self.trajectories // self.chunk)

    def size(self, index: int) -> int:
        """How many trajectories chunk `index` holds."""
        return min(self.chunk, self.trajectories - index * self.chunk)


@dataclass(frozen=True)
class ValueData:
    """Solved trajectories and the starts from which there was none.

    Attributes:
        states: (N, H+1, n).
        controls: (N, H, m).
        time_steps: (N,) [s].
        cpu_seconds: of each solved trajectory (N,).
        unsolved: starts without a trajectory (K, n).
        reasons: the solver's, for each of them.
        doomed: whether such a start cannot even keep clear of obstacles and bounds for a second, goal or not (K,).
        wasted_seconds: CPU seconds spent on them (K,).
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
    def success_rate(self) -> float:
        """Part of the random starts from which a trajectory was found."""
        return len(self.states) / (len(self.states) + len(self.unsolved))

    @property
    def success_rate_of_viable(self) -> float:
        """The same without the starts that are doomed."""
        return len(self.states) / (len(self.states) + int(np.sum(~self.doomed)))

    def values(
        self, problem: Problem, discount: float | None = None, whole_horizon: bool = False
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return V(x_m) by Eq. 3.13, and which states an episode would still meet, both (N, H+1).

        After its first goal, trap or collision an episode is over: what a trajectory does then is no state of it.

        Args:
            problem: whose task pays the rewards.
            discount: of a step of the task's policy; the task's own unless given.
            whole_horizon: whether the sum goes on after arrival, to the horizon's end, as the thesis may be read; every
                state counts then.
        """
        paid, ended = rewards(problem.task, problem.task_states(self.states))
        ended &= not whole_horizon
        over = np.logical_or.accumulate(ended, axis=1)
        met = np.column_stack((np.ones(len(over), dtype=bool), ~over[:, :-1]))
        per_step = step_discount(problem.task, problem.discount if discount is None else discount, self.time_steps)
        return returns(paid, ended, per_step), met


def description(problem: Problem, settings: DataSettings) -> dict[str, Any]:
    """Return what a folder of value data says about itself: other settings need another folder."""
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
    """Return the file of a chunk."""
    return folder / f"chunk-{index:04d}.npz"


def write_chunk(folder: Path, index: int, data: ValueData) -> None:
    """Write a chunk, whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    buffer = io.BytesIO()
    arrays: dict[str, Any] = {name: getattr(data, name) for name in ValueData.__annotations__}
    arrays["reasons"] = np.array(data.reasons, dtype=np.str_)
    np.savez(buffer, **arrays)
    write_whole(chunk_file(folder, index), buffer.getvalue())


def make_folder(folder: Path) -> None:
    """Make a folder for value data, if it is not there.

    Raises:
        OcError: it holds something else; what a killed call leaves behind does not count.
        OSError: it cannot be made.
    """
    folder.mkdir(parents=True, exist_ok=True)
    other = [file for file in folder.iterdir() if file.name != LOCK and not is_temporary(file)]
    if other and not (folder / "settings.json").exists():
        raise OcError(f"{folder} holds something else than value data, {other[0].name}: give another folder")


def open_folder(folder: Path, problem: Problem, settings: DataSettings) -> list[int]:
    """Begin or take up value data in a folder of `make_folder` and return the chunks that it still lacks.

    Only whoever has the folder's lock may: what a killed call left half-written is removed.

    Raises:
        OcError: the folder holds data of other settings.
        OSError: it cannot be written to.
    """
    file = folder / "settings.json"
    if file.exists():
        _check_same(folder, problem, settings)
    for left in filter(is_temporary, folder.iterdir()):
        left.unlink()
    if not file.exists():
        write_whole(file, json.dumps(description(problem, settings), indent=1) + "\n")
    return _lacking(folder, settings)


def _check_same(folder: Path, problem: Problem, settings: DataSettings) -> None:
    there = read_description(folder)
    for name, wanted in description(problem, settings).items():
        if there.get(name) != wanted:
            raise OcError(f"{folder} holds data with {name} = {there.get(name)}, not {wanted}: give another folder")


def _lacking(folder: Path, settings: DataSettings) -> list[int]:
    return [index for index in range(settings.chunks) if not chunk_file(folder, index).exists()]


def read_description(folder: Path) -> dict[str, Any]:
    """Return what a folder of value data says about itself.

    Raises:
        OcError: there is none, or it is wrong.
    """
    file = folder / "settings.json"
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise OcError(f"{folder} holds no value data: make them with 'oc data'") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise OcError(f"{file}: format is not '{FORMAT}': make the data again")
    wrong = [name for name, kind in _TYPES.items() if not isinstance(content.get(name), kind)]
    if wrong:
        raise OcError(f"{file}: {', '.join(wrong)} missing or of a wrong type: make the data again in another folder")
    return content


def load_data(folder: Path, problem: Problem) -> ValueData:
    """Read a whole folder of value data.

    Raises:
        OcError: it belongs to another problem, chunks are missing, or one cannot be read.
    """
    there = read_description(folder)
    settings = DataSettings(*(int(there[name]) for name in ("trajectories", "chunk", "seed")))
    _check_same(folder, problem, settings)
    lacking = _lacking(folder, settings)
    if lacking:
        raise OcError(f"{folder} lacks {len(lacking)} of {settings.chunks} chunks: run the same 'oc data' again")
    return join([_read_chunk(chunk_file(folder, index)) for index in range(settings.chunks)])


def join(parts: list[ValueData]) -> ValueData:
    """Return several chunks as one."""
    names = [name for name in ValueData.__annotations__ if name != "reasons"]
    arrays: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return ValueData(reasons=tuple(reason for part in parts for reason in part.reasons), **arrays)


def _read_chunk(file: Path) -> ValueData:
    try:
        with np.load(file, allow_pickle=False) as content:
            arrays = {name: content[name] for name in ValueData.__annotations__}
    except Exception as error:  # zipfile and NumPy raise nearly anything about a damaged archive
        raise OcError(f"{file} is not a whole chunk ({error}): delete it and run 'oc data' again") from None
    return ValueData(**{**arrays, "reasons": tuple(arrays["reasons"].tolist())})
