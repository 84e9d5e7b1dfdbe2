"""Small worlds in the format of BARN and DynaBARN, made here; none of the published ones is among them."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

_CODE_AT = 64
_ZERO, _KEEP, _CALL = b"\x66\x0f\xef\xc0", b"\xf2\x0f\x11\x45\xd0", b"\xe8\x00\x00\x00\x00"
_SYMBOL = b"_ZN6gazebo11AnimatedBox4LoadEN5boost10shared_ptrINS_7physics5ModelEEE"


def cylinder(name: str, x: float, y: float, radius: float = 0.075, plugin: str = "", lean: float = 0.0) -> str:
    """Return a model of an upright cylinder."""
    moves = f"<plugin name='{name}' filename='{plugin}'/>" if plugin else ""
    return (
        f"<model name='{name}'><static>1</static><pose frame=''>{x} {y} 0 {lean} 0 0</pose><link name='link'>"
        f"<collision name='c'><geometry><cylinder><radius>{radius}</radius><length>1</length></cylinder></geometry>"
        f"</collision></link>{moves}</model>"
    )


def box(name: str, x: float, y: float, size: tuple[float, float], yaw: float) -> str:
    """Return a model of a wall."""
    return (
        f"<model name='{name}'><pose>{x} {y} 0 0 0 {yaw}</pose><link name='link'><collision name='c'><geometry><box>"
        f"<size>{size[0]} {size[1]} 1</size></box></geometry></collision></link></model>"
    )


def world(*models: str) -> str:
    """Return a world with a floor."""
    floor = (
        "<model name='ground_plane'><link name='link'><collision name='c'><geometry><plane><normal>0 0 1</normal>"
        "<size>100 100</size></plane></geometry></collision></link></model>"
    )
    return f"<sdf version='1.6'><world name='default'>{floor}{''.join(models)}</world></sdf>"


def path_file(cells: object) -> bytes:
    """Return a path's cells (n, 2) as a NumPy file."""
    out = io.BytesIO()
    np.save(out, np.array(cells))
    return out.getvalue()


def plugin(frames: Sequence[tuple[float, float, float]], duration: float = 10.0) -> bytes:
    """Return a shared library whose `Load()` makes key frames (time, x, y) by the instructions that GCC writes."""
    numbers: list[float] = []
    code = b""
    places: list[int] = []

    def load(value: float) -> bytes:
        if value == 0.0:
            return _ZERO
        numbers.append(value)
        places.append(len(code) + 4)
        return b"\xf2\x0f\x10\x05\x00\x00\x00\x00"

    numbers.append(duration)
    places.append(3)
    code += (
        b"\x48\x8b\x05\x00\x00\x00\x00" + b"\x48\x89\x85\x00\x00\x00\x00" + b"\xf2\x0f\x10\x85\x00\x00\x00\x00" + _CALL
    )
    for time, x, y in frames:
        code += load(time)
        code += _CALL + _ZERO + _KEEP
        for value in (y, x):
            code += load(value)
            code += _KEEP
        code += _CALL + 3 * (_ZERO + _KEEP) + _CALL
    data_at = _CODE_AT + len(code)
    patched = bytearray(code)
    for index, place in enumerate(places):
        after = _CODE_AT + place + 4
        struct.pack_into("<i", patched, place, data_at + 8 * index - after)
    data = b"".join(struct.pack("<d", number) for number in numbers)
    names = b"\x00" + _SYMBOL + b"\x00"
    symbol = struct.pack("<IBBHQQ", 1, 0x12, 0, 1, _CODE_AT, len(code))
    names_at = data_at + len(data)
    symbols_at, table_at = names_at + len(names), names_at + len(names) + len(symbol)
    section = struct.Struct("<IIQQQQIIQQ")
    table = (
        section.pack(*(0,) * 10)
        + section.pack(0, 1, 6, _CODE_AT, _CODE_AT, len(code), 0, 0, 1, 0)
        + section.pack(0, 11, 2, symbols_at, symbols_at, len(symbol), 3, 0, 8, 24)
        + section.pack(0, 3, 2, names_at, names_at, len(names), 0, 0, 1, 0)
    )
    magic = b"\x7fELF\x02\x01\x01" + bytes(9)
    header = magic + struct.pack("<HHIQQQIHHHHHH", 3, 62, 1, 0, 0, table_at, 0, 64, 0, 0, 64, 4, 0)
    return header + bytes(patched) + data + names + symbol + table


def write_checkout(folder: Path) -> Path:
    """Write a checkout with world 0 of BARN, a passage round a wall of posts, and world 0 of DynaBARN."""
    root = folder / "jackal_helper"
    for part in ("worlds/BARN/path_files", "worlds/DynaBARN", "plugins"):
        (root / part).mkdir(parents=True)
    posts = [cylinder(f"unit_cylinder_{index}", -3.0 + 0.15 * index, 6.0) for index in range(11)]
    (root / "worlds/BARN/world_0.world").write_text(world(*posts, box("wall", 2.0, 8.0, (6.0, 0.2), 1.5707963)))
    (root / "worlds/BARN/path_files/path_0.npy").write_bytes(path_file([(22, 2), (22, 10), (16, 20), (16, 40)]))
    moving = world(cylinder("easylibobs_7", 0.0, 0.0, 0.3, "easylibobs_7.so")).replace("frame=''", "frame=")
    (root / "worlds/DynaBARN/world_0.world").write_text(moving)
    (root / "plugins/easylibobs_7.so").write_bytes(plugin(((0.0, 0.0, 3.0), (4.0, 1.5, -3.0), (8.0, 0.0, 3.0))))
    return folder
