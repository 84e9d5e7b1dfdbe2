"""Named arrays and a header in one safetensors file, whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ctrl_rl_core.io import TYPES, encode_tensors, read_tensors
from numpy.typing import NDArray

from ctrl_rl_core import atomic_write

_HEADER_KEY = "checkpoint"


def save_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], header: Mapping[str, Any]) -> None:
    """Write arrays, and a header that is JSON."""
    atomic_write(path, encode_tensors(arrays, _HEADER_KEY, header))


def load_arrays(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return arrays and header.

    Raises:
        FileError, ValidationError, OSError: `save_arrays` did not write it, or not so; see `file_checks.raise_as`.
    """
    header, arrays, _ = read_tensors(path, _HEADER_KEY, largest=None, types=tuple(TYPES))
    return arrays, header
