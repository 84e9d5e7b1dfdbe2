"""One array and its JSON description in a safetensors file, written atomically."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ctrl_rl_core.io import checked_tensors
from ctrl_rl_core.io.atomic_write import atomic_write
from ctrl_rl_core.io.file_checks import FileError
from ctrl_rl_core.io.schema import Name, Number, Schema, Sha256
from ctrl_rl_core.values.grid_axis import Axis, GridError

HEADER_KEY = "value_grid"
_TENSOR = "values"
_LARGEST_COUNT = 10_000_000


class AxisHeader(Schema):
    """Schema of an `Axis` in a file."""

    name: Name
    unit: Annotated[str, Field(max_length=100)]
    lower: Number
    upper: Number
    count: Annotated[int, Field(ge=2, le=_LARGEST_COUNT)]
    periodic: bool

    @property
    def axis(self) -> Axis:
        """The axis itself."""
        return Axis(**dict(self))


class GridText(Schema):
    """Description of a grid besides its axes, with the fields of `ValueGrid`."""

    kind: Literal["time_to_reach", "oc_value", "avoid", "reach_avoid"]
    task: Name
    task_digest: Sha256
    solver: Name
    residual: Annotated[float, Field(ge=0.0)]
    notes: dict[str, str]
    values_sha256: Sha256 | None = None
    """Digest of the values alone, in files that predate the digest of the whole file."""

    def check(self, values: NDArray[Any]) -> None:
        """Verify the checksum of the values.

        Raises:
            FileError: The checksum does not match.
        """
        if self.values_sha256 not in (None, values_digest(values)):
            raise FileError("has values that do not match their checksum; copy or compute it again")


class _GridHeader(GridText):
    format: Literal[1]
    unit: Annotated[str, Field(max_length=100)] = ""
    axes: Annotated[list[AxisHeader], Field(min_length=1, max_length=6)]


def encode(values: NDArray[Any], description: Mapping[str, Any]) -> bytes:
    """Return the bytes of the file, deterministic for the same values (float32 or float64) and description."""
    return checked_tensors.encode_tensors({_TENSOR: values}, HEADER_KEY, description)


def write_grid_file(path: Path, content: bytes, *, overwrite: bool) -> None:
    """Write the file atomically.

    Raises:
        GridError: The file exists and `overwrite` is false, or cannot be written.
    """
    if path.exists() and not overwrite:
        raise GridError(f"{path}: exists already; give another name or ask to overwrite it")
    try:
        atomic_write(path, content)
    except OSError as error:
        raise GridError(f"{path}: cannot be written: {error.strerror or error}") from error


def read(path: Path) -> tuple[NDArray[Any], tuple[Axis, ...], dict[str, Any]]:
    """Return values, axes and the rest of the description of a file.

    Raises:
        FileError, ValidationError, OSError: The file has no complete grid; `raise_as` converts each to one error class.
    """
    header, tensors, _ = checked_tensors.read_tensors(path, HEADER_KEY, largest=None, finite=False)
    told = _GridHeader.model_validate(header)
    if list(tensors) != [_TENSOR]:
        raise FileError("is not a value grid: it lacks the values, or has more than those")
    told.check(tensors[_TENSOR])
    text = {name: getattr(told, name) for name in GridText.model_fields if name != "values_sha256"}
    return tensors[_TENSOR], tuple(each.axis for each in told.axes), text


def values_digest(values: NDArray[Any]) -> str:
    """Return the SHA-256 (hex) of an array's values."""
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
