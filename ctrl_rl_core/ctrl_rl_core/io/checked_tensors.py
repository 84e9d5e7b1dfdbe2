"""Tensors and a JSON header in a safetensors file, validated before allocation, with a digest of the whole file.

The header is a single metadata entry (safetensors writes several in random order) and contains the digest: the SHA-256
of the whole file, computed with 64 zeros in place of the digest.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter
from safetensors.numpy import save

from ctrl_rl_core.io import checked_json
from ctrl_rl_core.io.checked_json import DIGEST
from ctrl_rl_core.io.file_checks import FileError, as_text, available_memory, open_file, short_repr
from ctrl_rl_core.io.schema import Count, Schema

Tensors = dict[str, NDArray[Any]]
LARGEST = 256_000_000
"""Maximum size of a policy file [bytes]."""
LARGEST_HEADER = 16_000_000
TYPES: dict[str, type[np.generic]] = {
    "F64": np.float64,
    "F32": np.float32,
    "F16": np.float16,
    "I64": np.int64,
    "I32": np.int32,
    "I16": np.int16,
    "I8": np.int8,
    "U64": np.uint64,
    "U32": np.uint32,
    "U16": np.uint16,
    "U8": np.uint8,
    "BOOL": np.bool_,
}
_ZEROS = b"0" * 64
KINDS = {
    "policy": "a Koopman policy, for koopman_lqr_controller's controller (policy:=FILE)",
    "option_policy": "a joint option policy, for option_coordinator's coordinator (policy:=FILE)",
    "actor": "an actor-1 network of a learning run, for ctrl_rl_core's policy (policy:=FILE)",
    "checkpoint": "a learning run's checkpoint, for the command that wrote it, which goes on from there",
    "visits": "states that a learning run visited, for the figures that its package draws",
    "value_grid": "a value grid, for ttr_reward_node's reward or oc_baseline_node's baseline (grid:=FILE)",
    "decomposed_value": "a time to reach in parts, for ttr_reward_node's reward (grid:=FILE)",
    "oc_value": "an optimal control value, for oc_baseline_node's baseline (grid:=FILE)",
}
"""Descriptions of the suite's file kinds, by header key."""


class _Entry(Schema):
    """Position of a tensor in the file [bytes after the header]."""

    dtype: str
    shape: Annotated[list[Count], Field(max_length=8)]
    data_offsets: Annotated[list[Count], Field(min_length=2, max_length=2)]


_ENTRIES = TypeAdapter(Annotated[dict[str, _Entry], Field(max_length=10_000)])


class TensorFile(NamedTuple):
    """Header and tensors of a file, and its SHA-256 (hex), empty if not requested."""

    header: dict[str, Any]
    tensors: Tensors
    digest: str


def encode_tensors(tensors: Mapping[str, NDArray[Any]], key: str, header: Mapping[str, Any]) -> bytes:
    """Return the bytes of a file, deterministic for the same tensors and header.

    Args:
        tensors: Arrays by tensor name.
        key: Metadata key that identifies the kind of file.
        header: JSON header without the digest.
    """
    plain = {name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}
    rest = json.dumps(dict(header), sort_keys=True)[1:]
    told = f'{{"{DIGEST}": "{_ZEROS.decode()}"{", " if header else ""}{rest}'
    content = save(plain, metadata={key: told})
    return content.replace(_ZEROS, hashlib.sha256(content).hexdigest().encode(), 1)


def kind_of(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Return the metadata keys of a file, which identify its kind.

    Raises:
        FileError, OSError: As for `read_tensors`.
    """
    with open_file(path, math.inf) as (file, size):
        return tuple(_parse_head(file.read(8 + min(size, LARGEST_HEADER)), size)[0])


def read_tensors(
    path: str | os.PathLike[str],
    key: str,
    largest: float | None = LARGEST,
    types: tuple[str, ...] = ("F32", "F64"),
    finite: bool = True,
    with_digest: bool = False,
) -> TensorFile:
    """Read a file of one kind and verify its digest.

    Args:
        path: The file to read.
        key: Metadata key that identifies the kind of file.
        largest: Maximum size [bytes]; None for as much as fits in memory.
        types: Allowed types of the tensors.
        finite: Whether to reject NaN and infinity.
        with_digest: Whether to return the file's SHA-256, which takes another pass over the file.

    Raises:
        FileError: The file is of another kind, too large, damaged, or has tensors of other types.
        OSError: The file cannot be read.
    """
    with open_file(path, available_memory() if largest is None else largest) as (file, size):
        head = file.read(min(size, 8))
        length = int.from_bytes(head, "little")
        if length <= LARGEST_HEADER:
            head += file.read(min(length, size))
        metadata, entries = _parse_head(head, size)
        if key not in metadata:
            known = next((found for found in metadata if found in KINDS), None)
            if known is not None:
                raise FileError(f"is {KINDS[known]}; wanted is {KINDS.get(key, repr(key))}")
            found = short_repr(next(iter(metadata), "without a header"))
            raise FileError(f"is a safetensors file of another kind, {found}, not {short_repr(key)}")
        header = checked_json.parse_json(metadata[key])
        if not isinstance(header, dict):
            raise FileError("has a header that is no JSON object")
        others = [name for name, entry in entries.items() if entry.dtype not in types]
        if others:
            raise FileError(
                f"tensor {short_repr(others[0])} is of type {short_repr(entries[others[0]].dtype)}: "
                f"must be {' or '.join(types)}"
            )
        data = np.fromfile(file, np.uint8, size - len(head))
        if len(data) != size - len(head):
            raise FileError("became shorter while it was read")
    found = header.pop(DIGEST, None)
    if found is None:
        checked_json.warn_missing_digest(path)
    else:
        _check_digest(head, data, found)
    digest = _sha256(head, data) if with_digest else ""
    tensors = {name: _tensor(data, entry) for name, entry in entries.items()}
    wrong = [n for n, it in tensors.items() if finite and it.dtype.kind == "f" and not np.isfinite(it).all()]
    if wrong:
        raise FileError(f"not all numbers of {short_repr(wrong[0])} are finite")
    return TensorFile(header, tensors, digest)


def _check_digest(head: bytes, data: NDArray[np.uint8], found: Any) -> None:
    place = head.find(found.encode()) if isinstance(found, str) and len(found) == len(_ZEROS) else -1
    if place < 0:
        raise FileError("has an invalid digest")
    if _sha256(head[:place] + _ZEROS + head[place + len(_ZEROS) :], data) != found:
        raise FileError("does not match its digest: it is damaged; copy or make it again")


def _sha256(head: bytes, data: NDArray[np.uint8]) -> str:
    sum_ = hashlib.sha256(head)
    sum_.update(data.data)
    return sum_.hexdigest()


def _parse_head(head: bytes, size: int) -> tuple[dict[str, str], dict[str, _Entry]]:
    """Parse the metadata and tensor entries from the start of a file of a given size."""
    length = int.from_bytes(head[:8], "little")
    if size < 10 or length > size - 8:
        raise FileError("is not a whole safetensors file: copy or make it again")
    if length > LARGEST_HEADER:
        raise FileError(f"has a header of {length:,} bytes: at most {LARGEST_HEADER:,} are read")
    told = checked_json.parse_json(as_text(head[8 : 8 + length]))
    metadata = told.pop("__metadata__", {}) if isinstance(told, dict) else None
    if not isinstance(metadata, dict) or not all(isinstance(text, str) for text in metadata.values()):
        raise FileError("is not a safetensors file: invalid header")
    entries = _ENTRIES.validate_python(told)
    end = 0
    for name, entry in sorted(entries.items(), key=lambda item: item[1].data_offsets):
        kind = TYPES.get(entry.dtype)
        if kind is None:
            raise FileError(f"tensor {short_repr(name)} is of type {short_repr(entry.dtype)}, which is not read")
        begin, stop = entry.data_offsets
        if begin != end or stop - begin != math.prod(entry.shape) * np.dtype(kind).itemsize:
            raise FileError(f"tensor {short_repr(name)} is not where its shape requires")
        end = stop
    if end != size - 8 - length:
        raise FileError("is not a whole safetensors file: copy or make it again")
    return metadata, entries


def _tensor(data: NDArray[np.uint8], entry: _Entry) -> NDArray[Any]:
    begin, stop = entry.data_offsets
    flat = data[begin:stop].view(TYPES[entry.dtype])
    if entry.dtype == "BOOL" and (data[begin:stop] > 1).any():
        raise FileError("has Boolean values that are neither 0 nor 1")
    return np.require(flat.reshape(entry.shape), requirements=["A"])
