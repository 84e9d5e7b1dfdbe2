"""One array and its JSON description in a safetensors file, written whole or not at all."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ctrl_rl_core.grid_axis import GridError
from ctrl_rl_core.whole_file import write_whole

# safetensors writes metadata keys in random order; with a single key, equal grids are equal files.
_HEADER_KEY = "value_grid"
_TENSOR = "values"
_DTYPES = {"F32": np.float32, "F64": np.float64}


def encode(values: NDArray[Any], description: Mapping[str, Any]) -> bytes:
    """Return the bytes of the file: the same for the same values (float32 or float64) and description."""
    header = json.dumps({**description, "values_sha256": values_digest(values)}, sort_keys=True, allow_nan=False)
    return save({_TENSOR: np.ascontiguousarray(values)}, metadata={_HEADER_KEY: header})


def write(path: Path, content: bytes, *, overwrite: bool) -> None:
    """Write the file, whole or not at all.

    Raises:
        GridError: the file exists and `overwrite` is false, or it cannot be written.
    """
    if path.exists() and not overwrite:
        raise GridError(f"{path}: exists already; give another name or ask to overwrite it")
    try:
        write_whole(path, content)
    except OSError as error:
        raise GridError(f"{path}: cannot be written: {error.strerror or error}") from error


def read(path: Path) -> tuple[NDArray[Any], dict[str, Any]]:
    """Values and description of a file.

    Raises:
        GridError: no such file, not a whole safetensors file, another kind of content, or a wrong checksum.
    """
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            names = list(file.keys())
            if _HEADER_KEY not in metadata or names != [_TENSOR]:
                raise GridError(
                    "is a safetensors file, but not a value grid (it lacks the tensor or the metadata of one)"
                )
            dtype = file.get_slice(_TENSOR).get_dtype()
            if dtype not in _DTYPES:
                raise GridError(f"holds values of type {dtype}; a value grid is F32 or F64")
            values = file.get_tensor(_TENSOR)
    except FileNotFoundError as error:
        raise GridError("there is no such file; compute the grid first or correct the path") from error
    except OSError as error:
        raise GridError(f"cannot be read: {error.strerror or error}") from error
    except SafetensorError as error:
        raise GridError(f"is not a whole safetensors file ({error}); copy or compute it again") from error
    try:
        description = json.loads(metadata[_HEADER_KEY])
    except ValueError as error:
        raise GridError(f"has metadata that is not JSON: {error}") from error
    if not isinstance(description, dict):
        raise GridError("has metadata that is not a JSON object")
    if description.pop("values_sha256", None) != values_digest(values):
        raise GridError("has values that do not match their checksum; copy or compute it again")
    return values, description


def values_digest(values: NDArray[Any]) -> str:
    """Return the SHA-256 (hex) of an array's numbers, which a file keeps to know itself whole."""
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
