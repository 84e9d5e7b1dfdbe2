"""Map files in the format of map_server: a YAML file with resolution, origin and thresholds, and its image."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated, BinaryIO, Literal
from warnings import catch_warnings

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image
from pydantic import ConfigDict, Field, Strict, model_validator

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.io.atomic_write import atomic_write
from ctrl_rl_core.io.checked_png import check_png
from ctrl_rl_core.io.checked_yaml import read_yaml
from ctrl_rl_core.io.file_checks import FileError, open_file, raise_as
from ctrl_rl_core.io.schema import Number, Schema

_LARGEST_IMAGE = 200_000_000
"""Maximum size of an image file [bytes]."""
_FORMATS = ("PPM", "PNG", "BMP")
_OPAQUE = _LARGEST_BYTE = 255
_DARK, _LIGHT, _GREY = 0, 254, 205
"""Grey levels of occupied, free and unknown cells, as written by map_saver."""
_FREE_OF_SAVER = 0.196
"""Threshold that makes map_saver's grey unknown. The 0.25 written until 2025 made it free (navigation2 #5278)."""

Origin = tuple[float, float, float]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


class MapFileError(CtrlRlError):
    """A map file cannot be read; the message names the file and the error."""


class _Header(Schema):
    """Keys of the YAML file, with map_server's defaults; unknown keys are ignored, as in map_server."""

    model_config = ConfigDict(extra="ignore")

    image: Annotated[str, Field(min_length=1, max_length=4096)]
    resolution: Annotated[float, Field(gt=0.0, le=1e3)]
    origin: Annotated[tuple[Number, Number, Number], Strict(False)]
    mode: Literal["trinary", "scale", "raw"] = "trinary"
    negate: bool | Literal[0, 1] = False
    occupied_thresh: Share = 0.65
    free_thresh: Share = 0.25

    @model_validator(mode="after")
    def _ordered(self) -> _Header:
        if self.free_thresh >= self.occupied_thresh:
            raise ValueError(f"free_thresh {self.free_thresh:g} must be less than occupied_thresh")
        return self


def read_map(path: str | os.PathLike[str], most: int) -> tuple[NDArray[np.int8], float, Origin]:
    """Return occupancies (rows, columns) from 0 to 100 or -1 for unknown, bottom row first; resolution [m]; origin.

    Args:
        path: Path of the YAML file.
        most: Maximum number of cells.

    Raises:
        MapFileError: A file is missing or invalid.
    """
    with raise_as(MapFileError, path):
        header = _Header.model_validate(read_yaml(path))
    image = Path(path).expanduser().parent / header.image
    with raise_as(MapFileError, image):
        shade, opaque = _shades(image, most, header.mode == "trinary")
    occupancy = shade if header.negate else 1.0 - shade
    return np.ascontiguousarray(_percent(header, occupancy, opaque)[::-1]), header.resolution, header.origin


def write_map(path: Path, cells: NDArray[np.int8], resolution: float, origin: Origin) -> None:
    """Write a map of occupied (100), free (0) and unknown (-1) cells, with the image beside the YAML file.

    Raises:
        OSError: A file cannot be written.
    """
    shades = np.full(cells.shape, _GREY, np.uint8)
    shades[cells == 0], shades[cells > 0] = _LIGHT, _DARK
    rows, columns = cells.shape
    image = path.with_suffix(".pgm")
    atomic_write(image, b"P5\n%d %d\n255\n" % (columns, rows) + shades[::-1].tobytes())
    header = {"image": image.name, "mode": "trinary", "resolution": resolution, "origin": list(origin)}
    header |= {"negate": 0, "occupied_thresh": 0.65, "free_thresh": _FREE_OF_SAVER}
    atomic_write(path, yaml.safe_dump(header, sort_keys=False, default_flow_style=None))


def _shades(path: Path, most: int, with_alpha: bool) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    """Return grey levels (rows, columns) from black 0 to white 1, top row first, and which pixels are opaque.

    Args:
        path: Path of the image.
        most: Maximum number of pixels.
        with_alpha: Whether alpha counts as a fourth colour channel, as in map_server's trinary mode.
    """
    with open_file(path, _LARGEST_IMAGE) as (file, _):
        check_png(file)
        try:
            with Image.open(file, formats=_FORMATS) as image:
                columns, rows = image.size
                if not 0 < rows * columns <= most:
                    raise FileError(f"has {columns} x {rows} pixels: at most {most:,} are read")
                decoder, _, begin, terms = image.tile[0]
                if decoder in ("ppm", "ppm_plain") and isinstance(terms, tuple):
                    return _netpbm(file, begin, (rows, columns, len(image.getbands())), int(terms[-1]), decoder), None
                if image.mode.startswith("I"):  # 16-bit image
                    return np.asarray(image, np.float32) / 65535.0, None
                if image.mode in ("1", "L"):
                    return np.asarray(image.convert("L"), np.float32) / 255.0, None
                pixels = np.asarray(image.convert("RGBA"))
                # An editor may add a fully opaque alpha channel, which must not lighten the grey of unknown cells.
                transparent = bool((pixels[..., 3] != _OPAQUE).any())
        except (FileError, MemoryError):
            raise
        except Exception as error:  # Pillow raises many error types for damaged files
            raise FileError(f"is not a readable image ({type(error).__name__}): PGM, PNG or BMP") from None
    channels = pixels if transparent and with_alpha else pixels[..., :3]
    return channels.mean(axis=-1, dtype=np.float32) / 255.0, pixels[..., 3] == _OPAQUE if transparent else None


def _netpbm(file: BinaryIO, begin: int, shape: tuple[int, int, int], largest: int, decoder: str) -> NDArray[np.float32]:
    """Return the grey levels of a PGM or PPM file in ASCII or with an unusual range, which Pillow reads slowly.

    Args:
        file: Image content.
        begin: Offset of the first pixel.
        shape: Rows, columns and channels.
        largest: Value of a white pixel.
        decoder: Pillow's name for the encoding.
    """
    file.seek(begin)
    content, count = file.read(), shape[0] * shape[1] * shape[2]
    if decoder == "ppm_plain":
        with catch_warnings(action="error"):  # for non-finite values
            numbers = np.fromstring(re.sub(rb"#[^\r\n]*", b"", content), np.int64, sep=" ")[:count]
    else:
        numbers = np.frombuffer(content, ">u2" if largest > _LARGEST_BYTE else "u1", count)
    if len(numbers) < count or (numbers < 0).any():
        raise FileError("ends before its last pixel, or has a pixel below 0")
    return np.minimum(numbers / np.float32(largest), 1.0).reshape(shape).mean(axis=-1, dtype=np.float32)


def _percent(header: _Header, occupancy: NDArray[np.float32], opaque: NDArray[np.bool_] | None) -> NDArray[np.int8]:
    """Convert grey levels to occupancies in percent, -1 for unknown, by the rules of map_server's modes."""
    if header.mode == "raw":
        shades = np.rint(255.0 * (occupancy if header.negate else 1.0 - occupancy)).astype(np.int16)
        return np.where(shades <= 100, shades, -1).astype(np.int8)
    out, free = np.full(occupancy.shape, -1, np.int8), header.free_thresh
    if header.mode == "scale":
        part = (occupancy - free) / (header.occupied_thresh - free)
        out = np.rint(np.clip(100.0 * part, 0.0, 100.0)).astype(np.int8)
    elif np.isin(np.rint(255.0 * (1.0 - occupancy)), (_DARK, _GREY, _LIGHT)).all():
        free = min(free, _FREE_OF_SAVER)
    out[occupancy < free] = 0
    out[occupancy > header.occupied_thresh] = 100
    if header.mode == "scale" and opaque is not None:
        out[~opaque] = -1
    return out
