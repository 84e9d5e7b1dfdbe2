"""Files of optimal control values: a network in safetensors with a JSON manifest, or a value grid."""

from __future__ import annotations

import math
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from ctrl_rl_core.io import (
    FileError,
    Name,
    Number,
    Positive,
    Schema,
    Sha256,
    Tensors,
    kind_of,
    raise_as,
    read_tensors,
    short_path,
)
from ctrl_rl_core.values import AxisHeader
from pydantic import ConfigDict, Field, model_validator

from ctrl_rl_core import ValueFunction, ValueGrid, atomic_write
from oc_baseline_node.errors import OcError
from oc_baseline_node.values.collision_set import CollisionHeader, CollisionSet
from oc_baseline_node.values.mlp_value import HEADER_KEY, MlpValue

_MOST_NODES = 200_000_000
_Error = Annotated[float, Field(ge=0.0, le=1e30)]


class _Errors(Schema):
    """Errors of the network [reward]."""

    model_config = ConfigDict(extra="allow")

    mae: _Error
    rmse: _Error
    std_of_values: _Error


class _Manifest(Schema):
    """Data and settings of the fit; other keys are informative."""

    model_config = ConfigDict(extra="allow")

    held_out: _Errors | None = None
    fitted: _Errors | None = None
    discount: Annotated[float, Field(gt=0.0, le=1.0)] | None = None


class _Header(Schema):
    format: Literal["oc-value-mlp-1"]
    activation: Literal["tanh"] = "tanh"
    task: Name
    task_digest: Sha256
    axes: Annotated[list[AxisHeader], Field(min_length=1, max_length=6)]
    offset: Number
    scale: Positive
    collisions: CollisionHeader | None
    manifest: _Manifest

    @model_validator(mode="after")
    def _sensible(self) -> _Header:
        if math.prod(axis.count for axis in self.axes) > _MOST_NODES:
            raise ValueError(f"axes: have more than {_MOST_NODES:,} nodes")
        return self


def save_value(value: MlpValue, path: Path, overwrite: bool = False) -> None:
    """Write a network atomically.

    Raises:
        OcError: The file exists and `overwrite` is False.
        OSError: The file cannot be written.
    """
    if path.exists() and not overwrite:
        raise OcError(f"{path} exists: give another name, or ask to overwrite it")
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, value.encoded)


def shipped_values() -> dict[str, Path]:
    """Return the shipped networks by task."""
    folder = Path(str(files("oc_baseline_node"))) / "values" / "pretrained"
    return {file.stem: file for file in sorted(folder.glob("*.safetensors"))}


def find_value(name_or_path: str | Path) -> Path:
    """Return the file of a shipped network, or the path unchanged.

    Raises:
        OcError: The file does not exist.
    """
    shipped = shipped_values()
    path = shipped.get(str(name_or_path), Path(name_or_path).expanduser())
    if not path.is_file():
        raise OcError(
            f"no value '{short_path(name_or_path)}': there are {', '.join(shipped) or 'none'}, "
            "or give a file of 'oc fit'"
        )
    return path


def load_value(path: Path) -> ValueFunction:
    """Load a network or a value grid.

    Raises:
        CtrlRlError: The file does not exist, or is neither.
    """
    with raise_as(OcError, path, "fit it again"):
        if HEADER_KEY not in kind_of(path):
            return ValueGrid.load(path)
        header, tensors, _ = read_tensors(path, HEADER_KEY)
        return _network(_Header.model_validate(header), tensors)


def load_network(path: Path) -> MlpValue:
    """Load a network.

    Raises:
        CtrlRlError: As for `load_value`, or the file contains a grid.
    """
    value = load_value(path)
    if not isinstance(value, MlpValue):
        raise OcError(f"{short_path(path)} holds a value grid: give the network's file")
    return value


def _network(told: _Header, tensors: Tensors) -> MlpValue:
    depth = len(tensors) // 2
    wanted = {f"{kind}_{index}" for kind in ("weight", "bias") for index in range(depth)}
    if set(tensors) != wanted:
        raise FileError("its tensors are not layers with one weight and one bias each")
    return MlpValue(
        layers=tuple(
            (tensors[f"weight_{i}"].astype(np.float64), tensors[f"bias_{i}"].astype(np.float64)) for i in range(depth)
        ),
        axes=tuple(each.axis for each in told.axes),
        offset=told.offset,
        scale=told.scale,
        task=told.task,
        task_digest=told.task_digest,
        collisions=None if told.collisions is None else CollisionSet.from_file(told.collisions),
        manifest=told.manifest.model_dump(exclude_unset=True),
    )
