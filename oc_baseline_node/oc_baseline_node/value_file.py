"""Files of optimal control values: a network in safetensors with a JSON manifest, or a value grid. No pickles."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.grid_axis import Axis
from ctrl_rl_core.value_function import ValueFunction
from ctrl_rl_core.value_grid import ValueGrid
from ctrl_rl_core.whole_file import write_whole
from safetensors import SafetensorError, safe_open

from oc_baseline_node.collision_set import CollisionSet
from oc_baseline_node.errors import OcError
from oc_baseline_node.mlp_value import FORMAT, HEADER_KEY, MlpValue


def save_value(value: MlpValue, path: Path, overwrite: bool = False) -> None:
    """Write a network; the file is there whole or not at all.

    Raises:
        OcError: the file exists and `overwrite` is false.
        OSError: it cannot be written.
    """
    if path.exists() and not overwrite:
        raise OcError(f"{path} exists: give another name, or ask to overwrite it")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, value.encoded)


def shipped_values() -> dict[str, Path]:
    """Return the networks that come with the package, by the name of their task."""
    folder = Path(str(files("oc_baseline_node"))) / "values"
    return {file.stem: file for file in sorted(folder.glob("*.safetensors"))}


def find_value(name_or_path: str | Path) -> Path:
    """Return the file of a network that comes with the package, or the path itself.

    Raises:
        OcError: there is no such file.
    """
    shipped = shipped_values()
    path = shipped.get(str(name_or_path), Path(name_or_path))
    if not path.is_file():
        raise OcError(
            f"no value '{name_or_path}': there are {', '.join(shipped) or 'none'}, or give a file of 'oc fit'"
        )
    return path


def load_value(path: Path) -> ValueFunction:
    """Read a network or a value grid, whichever the file holds.

    Raises:
        CtrlRlError: no such file, or it is neither; the message names it.
    """
    try:
        with safe_open(path, framework="numpy") as file:
            text = (file.metadata() or {}).get(HEADER_KEY)
            if text is None:
                return ValueGrid.load(path)
            header = json.loads(text)
            tensors = {name: file.get_tensor(name).astype(np.float64) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError, ValueError) as error:
        raise OcError(f"{path}: not a readable value file ({error})") from None
    return _network(path, header, tensors)


def load_network(path: Path) -> MlpValue:
    """Read a network.

    Raises:
        CtrlRlError: as `load_value`, or the file holds a grid.
    """
    value = load_value(path)
    if not isinstance(value, MlpValue):
        raise OcError(f"{path} holds a value grid: give the network's file")
    return value


def _network(path: Path, header: Any, tensors: dict[str, Any]) -> MlpValue:
    found = header.get("format") if isinstance(header, dict) else None
    if found != FORMAT:
        raise OcError(f"{path}: format is '{found}', must be '{FORMAT}': fit it again")
    try:
        layers = tuple((tensors[f"weight_{i}"], tensors[f"bias_{i}"]) for i in range(len(tensors) // 2))
        return MlpValue(
            layers=layers,
            axes=tuple(Axis(**axis) for axis in header["axes"]),
            offset=float(header["offset"]),
            scale=float(header["scale"]),
            task=header["task"],
            task_digest=header["task_digest"],
            collisions=None if header["collisions"] is None else CollisionSet.from_json(header["collisions"]),
            manifest=header["manifest"],
        )
    except (KeyError, TypeError, ValueError) as error:
        raise OcError(f"{path}: wrong header ({error}): fit it again") from None
    except CtrlRlError as error:
        raise OcError(f"{path}: {error}") from None
