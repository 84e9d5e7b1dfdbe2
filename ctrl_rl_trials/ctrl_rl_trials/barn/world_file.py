"""World and path files of the BARN challenge: SDF worlds, and lists of cells."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from ctrl_rl_core.io import FileError, as_text, raise_as, read_bytes
from numpy.typing import NDArray

from ctrl_rl_core import Box, Disc
from ctrl_rl_trials.errors import TrialError

_LARGEST_WORLD = 20e6
_FARTHEST = 1000.0
_MOST = 10_000
_UNQUOTED = re.compile(r"<pose frame=\s*>")
"""Invalid XML in DynaBARN's worlds, which Gazebo's parser accepts."""
_PLUGIN = re.compile(r"[A-Za-z0-9_]+\.so")


@dataclass(frozen=True)
class MovingCylinder:
    """Obstacle that a plugin moves.

    Attributes:
        plugin: File name of the plugin.
        radius: Radius of the cylinder [m].
    """

    plugin: str
    radius: float


@dataclass(frozen=True)
class WorldFile:
    """Static and moving obstacles of a world.

    Attributes:
        cylinders: Upright cylinders, as discs.
        boxes: Upright boxes, in the order of the file.
        moving: Cylinders that plugins move.
    """

    cylinders: tuple[Disc, ...]
    boxes: tuple[Box, ...]
    moving: tuple[MovingCylinder, ...]


def read_world(path: Path) -> WorldFile:
    """Read a world.

    Raises:
        TrialError: The file is missing, is no SDF world, or has a model that is neither a cylinder nor a box.
    """
    with raise_as(TrialError, path):
        text = as_text(read_bytes(path, _LARGEST_WORLD))
        if "<!" in text.replace("<!--", ""):
            raise FileError("declares entities or a document type, which no world needs")
        try:
            root = ET.fromstring(_UNQUOTED.sub("<pose>", text))
        except ET.ParseError as error:
            raise FileError(f"is not XML: {error}") from None
        models = root.findall("world/model")
        if root.tag != "sdf" or not models:
            raise FileError("is not an SDF world with models")
        if len(models) > _MOST:
            raise FileError(f"has {len(models)} models: at most {_MOST} are allowed")
        cylinders: list[Disc] = []
        boxes: list[Box] = []
        moving: list[MovingCylinder] = []
        for model in models:
            _add(model, cylinders, boxes, moving)
        return WorldFile(tuple(cylinders), tuple(boxes), tuple(moving))


def _add(model: ET.Element, cylinders: list[Disc], boxes: list[Box], moving: list[MovingCylinder]) -> None:
    name = model.get("name", "")
    shapes = model.findall("link/collision/geometry/*")
    if [shape.tag for shape in shapes] == ["plane"]:
        return
    if len(shapes) != 1 or shapes[0].tag not in ("cylinder", "box"):
        raise FileError(f"model '{name}': must have exactly one cylinder or box as its collision shape")
    (shape,) = shapes
    plugin = model.find("plugin")
    x, y, _, roll, pitch, yaw = _numbers(model.find("pose"), 6, name) if model.find("pose") is not None else (0.0,) * 6
    if roll or pitch:
        raise FileError(f"model '{name}': is tilted: only upright models are supported")
    if shape.tag == "box":
        width, depth, _ = _numbers(shape.find("size"), 3, name, positive=True)
        boxes.append(Box((x, y), (width, depth), yaw))
        return
    (radius,) = _numbers(shape.find("radius"), 1, name, positive=True)
    if plugin is None:
        cylinders.append(Disc((x, y), radius))
        return
    file = plugin.get("filename", "")
    if not _PLUGIN.fullmatch(file):
        raise FileError(f"model '{name}': its plugin must be a file name that ends in .so")
    moving.append(MovingCylinder(file, radius))


def _numbers(element: ET.Element | None, count: int, name: str, positive: bool = False) -> tuple[float, ...]:
    words = (element.text or "").split() if element is not None else []
    try:
        values = tuple(float(word) for word in words)
    except ValueError:
        values = ()
    fine = all(math.isfinite(value) and abs(value) <= _FARTHEST and (value > 0.0 or not positive) for value in values)
    if len(values) != count or not fine:
        what = "pose" if element is None else element.tag
        raise FileError(f"model '{name}': its {what} must be {count} {'positive ' if positive else ''}numbers")
    return values


_LARGEST_PATH = 1e6
_MOST_CELLS = 10_000
_CELL = 0.15
_ORIGIN = (-4.575, 5.075)
"""Cell (i, j) of a path lies at _ORIGIN + _CELL (i, j) in the world [m] (function path_coord_to_gazebo_coord)."""


def read_path(path: Path) -> NDArray[np.float64]:
    """Return the points (n, 2) of a path file in world coordinates [m].

    Raises:
        TrialError: The file is missing, or is no list of cells.
    """
    with raise_as(TrialError, path):
        content = read_bytes(path, _LARGEST_PATH)
        try:
            cells = np.lib.format.read_array(BytesIO(content), allow_pickle=False)
        except (ValueError, EOFError, OverflowError, MemoryError):
            raise FileError("is not a NumPy array of numbers") from None
        if (
            cells.ndim != 2
            or cells.shape[1] != 2
            or not 2 <= len(cells) <= _MOST_CELLS
            or cells.dtype.kind not in "iuf"
        ):
            raise FileError("must contain the cells of a path, two numbers each")
        cells = cells.astype(float)
        if not (np.abs(cells) <= _MOST_CELLS).all():
            raise FileError(f"has a cell beyond {_MOST_CELLS}, or one that is not finite")
        return np.asarray(_ORIGIN + _CELL * cells, float)
