"""Named arrays and a header in one safetensors file, whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.whole_file import write_whole
from numpy.typing import NDArray
from safetensors import safe_open
from safetensors.numpy import save

_HEADER_KEY = "checkpoint"


def save_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], header: Mapping[str, Any]) -> None:
    """Write arrays, and a header that is JSON."""
    content = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    write_whole(path, save(content, metadata={_HEADER_KEY: json.dumps(dict(header))}))


def load_arrays(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return arrays and header.

    Raises:
        OSError, SafetensorError, ValueError, KeyError: the file cannot be read, or `save_arrays` did not write it.
    """
    with safe_open(path, framework="np") as file:
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dictionary
        header: dict[str, Any] = json.loads((file.metadata() or {})[_HEADER_KEY])
    return arrays, header
