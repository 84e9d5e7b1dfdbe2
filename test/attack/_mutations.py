"""Broken files, made from whole ones: of each kind of file, the faults that disks, people and attackers make."""

from __future__ import annotations

import copy
import io
import json
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import yaml
from ctrl_rl_core.io import encode_arrays, encode_tensors, with_digest

Random = np.random.Generator
Mutate = Callable[[bytes, Random], bytes]
_DEEPEST = 100_000
"""Calls within each other that YAML of 1,000 levels may take."""

_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2**31, -(2**63), 10**12, 10**30, 0.5, -0.5, 1e300, -1e300, 1e-300),
    *(
        float("nan"),
        float("inf"),
        -float("inf"),
        "",
        "x",
        "1",
        "nan",
        "1e9 s",
        "x" * 4000,
        "a\nb\x1b[2J",
        "\u2028",
        "../../x",
    ),
    *([], {}, [[]], [None], [[1.0]], [0] * 50, {"": 1}, {"x": {"y": []}}),
)


def flip(content: bytes, random: Random) -> bytes:
    """Return it with a bit the other way round."""
    out = bytearray(content)
    out[int(random.integers(len(out)))] ^= 1 << int(random.integers(8))
    return bytes(out)


def cut(content: bytes, random: Random) -> bytes:
    """Return its beginning, or it with something behind."""
    if random.random() < 0.2:
        return content + random.bytes(int(random.integers(1, 100)))
    return content[: int(random.integers(len(content)))]


def overwrite(content: bytes, random: Random) -> bytes:
    """Return it with some bytes overwritten, as a sector that was lost."""
    begin, length = int(random.integers(len(content))), int(random.integers(1, 600))
    lost = bytes(length) if random.random() < 0.5 else random.bytes(length)
    return (content[:begin] + lost + content[begin + length :])[: len(content)]


def places(content: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the way to each value within lists and objects."""
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in items:
        yield (*here, key)
        yield from places(value, (*here, key))


def change(content: Any, random: Random) -> Any:
    """Return plain data with one to three of its values changed, deleted, doubled, nested, swapped or renamed."""
    out = copy.deepcopy(content)
    for _ in range(int(random.integers(1, 4))):
        ways = list(places(out))
        if not ways:
            return out
        depth = {len(way) for way in ways}
        chosen = int(random.choice(sorted(depth)))  # long lists would else take nearly all
        way = ways[int(random.choice([i for i, each in enumerate(ways) if len(each) == chosen]))]
        parent = out
        for key in way[:-1]:
            parent = parent[key]
        _change_one(parent, way[-1], random)
    return out


def _change_one(parent: Any, key: Any, random: Random) -> None:
    value = parent[key]
    what = int(random.integers(8))
    if what == 0:
        del parent[key]
    elif what == 1:
        for _ in range(int(random.choice([1, 30, 300]))):
            value = [value] if random.random() < 0.5 else {"a": value}
        parent[key] = value
    elif what == 2 and isinstance(value, int | float) and not isinstance(value, bool):
        parent[key] = value * random.choice([-1, 0, 1000, 1e12]).item()
    elif what == 3 and isinstance(parent, dict):
        parent[str(random.choice(["x", "", f"{key} ", "sha256", "__metadata__"]))] = parent.pop(key)
    elif what == 4 and isinstance(value, list):
        parent[key] = value[::-1] if random.random() < 0.5 else value[: len(value) // 2]
    elif what == 5 and isinstance(parent, list):
        parent.extend([value] * int(random.choice([1, 100])))
    elif what == 6 and isinstance(value, str):
        parent[key] = value[::-1]
    else:
        parent[key] = copy.deepcopy(_VALUES[int(random.integers(len(_VALUES)))])


def change_json(content: bytes, random: Random) -> bytes:
    """Return a JSON file that says something else: with a digest that fits, with its old one, or with none."""
    plain = json.loads(content)
    if not isinstance(plain, dict):
        return json.dumps(change(plain, random)).encode()
    old = plain.pop("sha256", None)
    plain, what = change(plain, random), random.random()
    if what < 0.1 and old is not None:
        plain["sha256"] = old
    elif what < 0.6:
        plain = with_digest(plain)
    text = json.dumps(plain)
    return _double_key(text, random).encode() if what > 0.95 else text.encode()


def change_yaml(content: bytes, random: Random) -> bytes:
    """Return a YAML file that says something else, or that names parts of itself."""
    text = content.decode()
    if random.random() < 0.1:
        return (text + "\nx: &x [1, 1]\ny: &y [*x, *x]\nz: [*y, *y]\n").encode()
    if random.random() < 0.1:
        lines = text.splitlines(keepends=True)
        index = int(random.integers(len(lines)))
        return "".join([*lines[:index], lines[index], *lines[index:]]).encode()
    return _dump_yaml(change(yaml.safe_load(text), random)).encode()


def _dump_yaml(content: object) -> str:
    """Return content as YAML, however deep: the dumper calls itself for each level."""
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(_DEEPEST)
    try:
        return yaml.safe_dump(content, sort_keys=False)
    finally:
        sys.setrecursionlimit(limit)


def change_tensors(content: bytes, random: Random) -> bytes:
    """Return a safetensors file with another header, other tensors, or other places of tensors."""
    length = int.from_bytes(content[:8], "little")
    head, data = json.loads(content[8 : 8 + length]), content[8 + length :]
    what = random.random()
    if what < 0.15:
        head = change(head, random)
        text = json.dumps(head)
        text = _double_key(text, random) if random.random() < 0.2 else text
        return len(text.encode()).to_bytes(8, "little") + text.encode() + data
    metadata = head.pop("__metadata__", {"": "{}"})
    key = next(iter(metadata))
    header = json.loads(metadata[key])
    header.pop("sha256", None)
    kinds = {"F64": np.float64, "F32": np.float32, "I64": np.int64, "U32": np.uint32, "U8": np.uint8, "BOOL": np.bool_}
    tensors = {
        name: np.frombuffer(data[slice(*it["data_offsets"])], kinds[it["dtype"]]).reshape(it["shape"]).copy()
        for name, it in head.items()
    }
    if what < 0.75:
        header = change(header, random)
    else:
        _change_tensor(tensors, random)
    if random.random() < 0.5 and isinstance(header, dict):
        return encode_tensors(tensors, key, header)
    from safetensors.numpy import save

    return bytes(save({n: np.ascontiguousarray(t) for n, t in tensors.items()}, metadata={key: json.dumps(header)}))


def _change_tensor(tensors: dict[str, Any], random: Random) -> None:
    name = str(random.choice(sorted(tensors)))
    tensor, what = tensors[name], int(random.integers(7))
    if what == 0:
        del tensors[name]
    elif what == 1 and tensor.size and tensor.dtype.kind != "U":
        tensor.flat[int(random.integers(tensor.size))] = (
            -1.0 if tensor.dtype.kind != "f" else random.choice([np.nan, np.inf, -np.inf, 1e30, -1e30, 0.0])
        )
    elif what == 2 and tensor.dtype.kind != "U":
        tensors[name] = tensor.astype(random.choice([np.float64, np.float32, np.int64, np.uint8, np.bool_]))
    elif what == 3:
        tensors[name] = tensor[..., None] if random.random() < 0.5 else tensor.reshape(-1)
    elif what == 4:
        tensors[name] = tensor[:0]
    elif what == 5:
        tensors["x"] = tensor
    else:
        tensors[name] = np.concatenate([tensor, tensor]) if tensor.ndim else tensor[None]


def change_arrays(content: bytes, random: Random) -> bytes:
    """Return an .npz file with other arrays, of other types or shapes."""
    with np.load(io.BytesIO(content)) as archive:
        arrays = {name: archive[name] for name in archive.files if name != "sha256"}
    _change_tensor(arrays, random)
    if random.random() < 0.5:
        return encode_arrays(arrays)
    buffer = io.BytesIO()
    if random.random() < 0.2:
        arrays["reasons"] = np.array([{"a": 1}], dtype=object)
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def _double_key(text: str, random: Random) -> str:
    braces = [index for index, each in enumerate(text) if each == "{" and text[index + 1 : index + 2] == '"']
    if not braces:
        return text
    index = int(random.choice(braces)) + 1
    key = text[index : text.index('"', index + 1) + 1]
    return f"{text[:index]}{key}: 0, {text[index:]}"


def broken(content: bytes, how: Mutate, random: Random) -> bytes:
    """Return a broken version of a file: half of them by what lies in it, half by its bytes."""
    if random.random() < 0.6:
        return how(content, random)
    return (flip, cut, overwrite)[int(random.integers(3))](content, random)
