"""Digests of what a command leaves: arrays, safetensors files, JSON, bags, printed numbers; none of our modules reads.

Every function returns parts: a digest for each name, so that a difference can be named.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from messages import STORE
from rosbags.highlevel import AnyReader
from safetensors import safe_open

Parts = dict[str, str]

_LENGTH = 16
_UNREPEATABLE = re.compile(
    r"second|cpu|wall|date|commit|command|sha256|digest|version|latency|memory|host|/time(?=[/\[.]|$)", re.IGNORECASE
)
"""Words in the name of what depends on the machine, the day or the wording: times, commits, digests of whole files."""
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def digest(data: bytes | str) -> str:
    """Return a short SHA-256."""
    return hashlib.sha256(data.encode() if isinstance(data, str) else data).hexdigest()[:_LENGTH]


def whole(parts: Mapping[str, str]) -> str:
    """Return one digest of all parts."""
    return digest(json.dumps(sorted(parts.items())))


def array_digest(array: np.ndarray) -> str:
    """Return a digest of type, shape and bytes."""
    return digest(f"{array.dtype.str} {array.shape} ".encode() + np.ascontiguousarray(array).tobytes())


def tensor_parts(file: Path) -> tuple[Parts, Parts]:
    """Return the parts of a safetensors file: its tensors, and its header's entries."""
    with safe_open(file, "np") as opened:
        tensors = {name: array_digest(opened.get_tensor(name)) for name in opened.keys()}  # noqa: SIM118
        header = {name: _as_json(text) for name, text in (opened.metadata() or {}).items()}
    return tensors, {name: digest(repr(value)) for name, value in leaves(header)}


def array_parts(file: Path) -> Parts:
    """Return the parts of an .npz file."""
    with np.load(file) as arrays:
        return {name: array_digest(arrays[name]) for name in arrays.files if not _UNREPEATABLE.search(name)}


def json_parts(file: Path) -> tuple[Parts, Parts]:
    """Return the parts of a JSON file: its numbers, and its words."""
    numbers: dict[str, list[float]] = {}
    words: Parts = {}
    for name, value in leaves(json.loads(file.read_text(encoding="utf-8"))):
        if isinstance(value, str):
            words[name] = digest(value)
        elif value is not None:
            numbers.setdefault(re.sub(r"\[\d+\]", "[]", name), []).append(float(value))
    return {name: digest(repr(values)) for name, values in numbers.items()}, words


def leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (path, value) of everything in a JSON value that does not depend on machine, day or wording.

    Rows of results are named by method and metric, elements of other lists by their index.
    """
    if isinstance(value, Mapping):
        if _UNREPEATABLE.search(str(value.get("unit", ""))):  # CPU s
            return
        for key, each in value.items():
            if not _UNREPEATABLE.search(key):
                yield from leaves(each, f"{name}/{key}")
    elif isinstance(value, list):
        for index, each in enumerate(value):
            row = isinstance(each, Mapping) and "metric" in each
            if row and _UNREPEATABLE.search(f"/{each['metric']}"):  # time, CPU time
                continue
            yield from leaves(each, f"{name}/{each['method']}/{each['metric']}" if row else f"{name}[{index}]")
    else:
        yield name, value


def bag_parts(folder: Path) -> tuple[Parts, Parts]:
    """Return the parts of a bag: each topic's messages with their log times, and types and counts."""
    topics: dict[str, list[str]] = {}
    types: Parts = {}
    with AnyReader([folder], default_typestore=STORE) as reader:
        for connection, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            topics.setdefault(connection.topic, []).append(f"{time} {message_text(message)}")
            types[connection.topic] = f"{connection.msgtype} {connection.digest}"
    return {name: digest("\n".join(lines)) for name, lines in topics.items()}, types


def message_text(message: Any) -> str:
    """Return all fields of a message, of rosbags or of rclpy, as text; numbers to the last bit."""
    if isinstance(message, np.ndarray):
        return message_text(message.tolist())
    if isinstance(message, float):
        return "nan" if math.isnan(message) else message.hex()
    if hasattr(message, "get_fields_and_field_types"):
        inner = {name: getattr(message, name) for name in message.get_fields_and_field_types()}
    elif is_dataclass(message):
        inner = {field.name: getattr(message, field.name) for field in fields(message) if field.name != "__msgtype__"}
    elif isinstance(message, (bytes, str)) or not hasattr(message, "__iter__"):
        return repr(message)
    else:
        return f"[{','.join(map(message_text, message))}]"
    return f"({','.join(f'{name}={message_text(each)}' for name, each in inner.items())})"


def printed_parts(text: str, left_out: str) -> Parts:
    """Return the numbers that a command printed, as one part; lines that match `left_out` do not count."""
    lines = [line for line in text.splitlines() if not (left_out and re.search(left_out, line))]
    return {"printed": digest(" ".join(number for line in lines for number in _NUMBER.findall(line)))}


def _as_json(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text
