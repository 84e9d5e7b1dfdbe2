"""Read the motions of DynaBARN's obstacles from compiled Gazebo plugins, as data; the plugins are never loaded or run.

`Load()` of such a plugin creates a `PoseAnimation` with a duration and calls, for each key frame,
`CreateKeyFrame(time)`, `Translation(Vector3d(x, y, 0))` and `Rotation(Quaterniond(0, 0, 0))` with literal numbers. The
compiler kept the order of the source: for each number, one instruction either loads it from an address relative to the
instruction or sets a register to zero. This module accepts exactly that sequence of instructions and refuses any other.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from ctrl_rl_core.io import FileError, raise_as, read_bytes

from ctrl_rl_trials.errors import TrialError

_LARGEST = 20e6
_FARTHEST = 10.0
_LONGEST = 1000.0
_MOST_FRAMES = 1000
_ELF = b"\x7fELF\x02\x01"  # 64 bit, little-endian
_X86_64 = 62
_DYNAMIC_SYMBOLS = 11
_SECTION, _SYMBOL = struct.Struct("<IIQQQQIIQQ"), struct.Struct("<IBBHQQ")
_LOAD = re.compile(rb"_ZN6gazebo\w{1,200}4LoadEN5boost10shared_ptr")
_MOST_SECTIONS, _MOST_SYMBOLS = 1000, 20_000
"""Maximum numbers of entries to read; DynaBARN's plugins have about 40 and 400."""
_INSTRUCTIONS = re.compile(
    rb"(?P<z>\x66\x0f\xef\xc0)"  # pxor xmm0, xmm0: a zero
    rb"|(?P<c>\xf2\x0f\x10\x05.{4})"  # movsd xmm0, [rip + ....]: loads a number
    rb"|(?P<a>\x48\x8b\x05.{4}(?=.{0,8}?\x48\x89\x85.{4}\xf2\x0f\x10\x85))"  # mov rax, [rip + ....]: by way of rax
    rb"|(?P<s>\xf2\x0f\x11(?:\x45.|\x85.{4}))"  # movsd [rbp + ..], xmm0: stores it
    rb"|(?P<k>\xe8.{4})",  # call
    re.DOTALL,
)
_FRAME = re.compile("(?P<t>[zca])k" + "zs" + "(?P<y>[zc])s" + "(?P<x>[zc])s" + "k+" + "zszszs" + "k+")


@dataclass(frozen=True)
class Keyframes:
    """Key frames of one obstacle.

    Attributes:
        times: Times (n,), increasing from 0 [s].
        points: Positions x, y (n,) [m, m].
    """

    times: tuple[float, ...]
    points: tuple[tuple[float, float], ...]


def read_keyframes(path: Path) -> Keyframes:
    """Read the key frames of a plugin.

    Raises:
        TrialError: The file is no such plugin, or its numbers are implausible.
    """
    with raise_as(TrialError, path):
        content = read_bytes(path, _LARGEST)
        try:
            begin, end = _load_function(content)
            frames = list(_frames(content, begin, end))
        except (struct.error, IndexError, ValueError, OverflowError):
            raise FileError("is damaged: its tables point outside of the file") from None
        return _checked(frames)


def _load_function(content: bytes) -> tuple[int, int]:
    """Return start and end of the code of `Load()` in the file."""
    if content[:6] != _ELF or struct.unpack_from("<H", content, 18)[0] != _X86_64:
        raise FileError("is no shared library for x86-64: DynaBARN's plugins are")
    (table,), (size, count) = struct.unpack_from("<Q", content, 40), struct.unpack_from("<HH", content, 58)
    if size != _SECTION.size or count > _MOST_SECTIONS:
        raise FileError("has a table of sections that no plugin of DynaBARN has")
    sections = [_SECTION.unpack_from(content, table + index * size) for index in range(count)]
    symbols = next((section for section in sections if section[1] == _DYNAMIC_SYMBOLS), None)
    if symbols is None or symbols[5] > _MOST_SYMBOLS * _SYMBOL.size:
        raise FileError("has no table of symbols, or a longer one than a plugin of DynaBARN")
    names = sections[symbols[6]][4]
    for place in range(symbols[4], symbols[4] + symbols[5], _SYMBOL.size):
        name, _, _, home, value, length = _SYMBOL.unpack_from(content, place)
        if length and _LOAD.match(content, names + name):
            offset = value - sections[home][3] + sections[home][4]
            if value != offset or offset + length > len(content):
                raise FileError("has its code where no plugin of DynaBARN has it")
            return offset, offset + length
    raise FileError("has no function Load() of a Gazebo plugin")


def _frames(content: bytes, begin: int, end: int) -> Iterator[tuple[float, float, float]]:
    """Yield the key frames: time [s], x, y [m]."""
    found = list(_INSTRUCTIONS.finditer(content, begin, end))
    kinds = "".join(str(each.lastgroup) for each in found)
    first = _FRAME.search(kinds)
    place = first.start() if first else len(kinds)
    # Before the first key frame: the animation's name, its duration, and the calls that create it.
    if first is None or kinds[:place].replace("k", "") != "a":
        raise FileError("has no key frames in the order in which DynaBARN's plugins have them")
    while frame := _FRAME.match(kinds, place):
        values = [_number(content, found[frame.start(name)]) for name in ("t", "x", "y")]
        yield values[0], values[1], values[2]
        place = frame.end()
    if kinds[place:].strip("k"):
        raise FileError("has numbers after its key frames: it is no plugin of DynaBARN")


def _number(content: bytes, instruction: re.Match[bytes]) -> float:
    """Return the number that an instruction loads."""
    if instruction.lastgroup == "z":
        return 0.0
    (offset,) = struct.unpack("<i", instruction.group()[-4:])
    place = instruction.end() + offset
    if not 0 <= place <= len(content) - 8:
        raise FileError("has a number outside of the file")
    return float(struct.unpack_from("<d", content, place)[0])


def _checked(frames: list[tuple[float, float, float]]) -> Keyframes:
    if not 2 <= len(frames) <= _MOST_FRAMES:
        raise FileError(f"has {len(frames)} key frames: a motion needs 2 to {_MOST_FRAMES}")
    times = [time for time, _, _ in frames]
    rising = all(one < other for one, other in pairwise(times))
    if times[0] != 0.0 or not rising or not times[-1] <= _LONGEST:
        raise FileError(
            f"has key frames at {times[0]:g} to {times[-1]:g} s: times must increase from 0 to {_LONGEST:g} s"
        )
    for _, x, y in frames:
        if not (abs(x) <= _FARTHEST and abs(y) <= _FARTHEST):
            raise FileError(f"has a key frame at ({x:g}, {y:g}) m: DynaBARN's arena extends to {_FARTHEST:g} m")
    return Keyframes(tuple(times), tuple((x, y) for _, x, y in frames))
