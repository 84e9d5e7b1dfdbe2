"""Named arrays in an .npz file; names, types and unpacked size are checked before unpacking."""

from __future__ import annotations

import hashlib
import io
import math
import os
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ctrl_rl_core.io.checked_json import DIGEST, warn_missing_digest
from ctrl_rl_core.io.file_checks import FileError, read_bytes, short_repr

Arrays = dict[str, NDArray[Any]]
_DAMAGE = (zipfile.BadZipFile, zlib.error, ValueError, EOFError, NotImplementedError, RuntimeError, KeyError, TypeError)
"""Exceptions that zipfile and NumPy raise for a damaged archive."""


def encode_arrays(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the bytes of an archive that includes a digest."""
    buffer, everything = io.BytesIO(), dict(arrays)
    everything[DIGEST] = np.array(digest(arrays))
    np.savez(buffer, allow_pickle=False, **everything)
    return buffer.getvalue()


def read_arrays(path: str | os.PathLike[str], names: Sequence[str], largest: int) -> Arrays:
    """Read the arrays of an archive: booleans, integers, finite numbers, and text.

    Args:
        path: The file to read.
        names: Names of all expected arrays.
        largest: Maximum total unpacked size [bytes].

    Raises:
        FileError: The file is not such an archive, is too large, or is damaged.
        OSError: The file cannot be read.
    """
    content = io.BytesIO(read_bytes(path, largest))
    try:
        with zipfile.ZipFile(content) as archive:
            arrays = _unpack(archive, {*names, DIGEST}, largest)
    except _DAMAGE as error:
        raise FileError(f"is not a whole .npz file: {error}") from None
    found = arrays.pop(DIGEST, None)
    lacking = [name for name in names if name not in arrays]
    if lacking:
        raise FileError(f"lacks {short_repr(lacking[0])}")
    if found is None:
        warn_missing_digest(path)
    elif str(found) != digest(arrays):
        raise FileError("does not match its digest: it is damaged; copy or make it again")
    return arrays


def digest(arrays: Mapping[str, NDArray[Any]]) -> str:
    """Return the SHA-256 (hex) of the names, types, shapes and contents of arrays."""
    sum_ = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        sum_.update(f"{name} {array.dtype.str} {np.shape(arrays[name])}\n".encode())
        sum_.update(array.tobytes())
    return sum_.hexdigest()


def _unpack(archive: zipfile.ZipFile, names: set[str], largest: int) -> Arrays:
    entries = archive.infolist()
    unknown = [entry.filename for entry in entries if entry.filename.removesuffix(".npy") not in names]
    if unknown or len({entry.filename for entry in entries}) < len(entries):
        raise FileError(f"holds {short_repr(unknown[0]) if unknown else 'an array twice'}")
    size = sum(entry.file_size for entry in entries)
    if size > largest:
        raise FileError(f"is too large: {size:,} bytes unpacked, at most {largest:,} are read")
    out: Arrays = {}
    for entry in entries:
        name = entry.filename.removesuffix(".npy")
        out[name] = _array(name, archive.read(entry))
    return out


def _array(name: str, content: bytes) -> NDArray[Any]:
    stream = io.BytesIO(content)
    version = npy.read_magic(stream)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = read_header(stream, max_header_size=10_000)
    if dtype.kind not in "biufU":
        raise FileError(f"{name} is of type {dtype}: must be numbers or texts")
    if math.prod(shape) * dtype.itemsize != len(content) - stream.tell():
        raise FileError(f"{name} has another size than its shape {shape} says")
    stream.seek(0)
    array: NDArray[Any] = npy.read_array(stream, allow_pickle=False)
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise FileError(f"not all numbers of {name} are finite")
    return array
