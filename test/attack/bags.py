"""Bags of others: damaged, cut off, put together anew, and made to be large, foreign or wrong.

Each round makes bags, spoils them, and lets `bag info`, `bag recover`, reading, copying, relabelling and what
`bag play` does before it publishes have them, each in a process of its own with little memory.
"""

from __future__ import annotations

import itertools
import json
import re
import shutil
import struct
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import numpy as np
import yaml
import zstandard
from _attack import Attack
from _limited import run_limited
from ctrl_rl_bags.recording import UnknownTypeError, message_class
from mcap.opcode import Opcode

from ctrl_rl_bags import BagWriter, Topic, message_definition, read_raw

T = TypeVar("T")
Random = np.random.Generator
_MEMORY = 1_200_000_000
"""Address space of a command [bytes]; Python, NumPy and rclpy with its libraries take 0.7 GB of it."""
_LIMIT_S = 60
_FOREIGN = (
    "this/msg/X",
    ".x/msg/Y",
    "os/msg/path",
    "antigravity/msg/X",
    "a" * 5000,
    "std_msgs/msg/\n",
    "\x1b[2J/msg/X",
    "",
)
_DEFINITIONS = (
    "string data\n",
    "string[100000000] data\n",
    "uint8[0] data\n",
    "evil/A a\n" + "=" * 80 + "\nMSG: evil/A\nevil/A a\n",
    "int32 data\n" * 50_000,
    "\0\xff",
    "bool data\n" * 3,
    "import os\n",
)
_TYPE_NAME = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*", re.ASCII)
_YAML = (
    "[" * 5000,
    "\n".join(["a0: &a0 [1]", *(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]" for i in range(1, 30))]),
    "? " * 5000,
    "!!python/object/apply:os.system [id]",
    "x" * (1 << 20),
)

_USE = """
import json, sys
from pathlib import Path
import numpy as np
from ctrl_rl_bags import copy_bag, read_messages, read_serialized
from ctrl_rl_core import CtrlRlError

bag, output, what = sys.argv[1:]
try:
    if what == "decode":
        for message in read_messages(bag):
            pass
    elif what == "read":
        for message in read_serialized(bag):
            print(json.dumps([message.topic, message.data.hex()]))
    elif what == "copy":
        copy_bag(bag, output, [], lambda message: ())
    elif what == "play":
        from ctrl_rl_bags import bag_info
        from ctrl_rl_bags.recording import UnknownTypeError, message_class, publisher_qos
        for name, topic in bag_info(bag).topics.items():
            try:
                message_class(topic.type)
            except UnknownTypeError:
                pass
            publisher_qos(topic.qos, 10)
    elif what == "relabel":
        from ttr_reward_node import relabel
        class Flat:  # what is attacked is the bag; a solved function would say the same slowly
            state_names, digest = ("x", "y", "theta"), "0"
            def value_and_gradient_at(self, state):
                return 1.0, np.zeros(3)
        relabel(Path(bag), Path(output), Flat(), lambda state, value: (0, -value))
    else:
        from ctrl_rl_bags.cli import main
        code = main([what, bag, *(["-o", output] if what == "recover" else [])])
        bad = {"this", "antigravity"} & set(sys.modules)
        assert not bad, bad
        sys.exit(code)
except CtrlRlError as error:
    print(f"use: {error}", file=sys.stderr)
    sys.exit(1)
finally:
    bad = {"this", "antigravity"} & set(sys.modules)
    assert not bad, bad
"""


def run(generator: Random, folder: Path) -> None:
    """Spoil a few bags and use each in every way."""
    for number in range(2):
        bag = folder / f"bag{number}"
        made = _make(generator, bag)
        _choice(generator, _SPOIL)(generator, bag)
        for what in generator.permutation(("info", "recover", "read", "decode", "copy", "play", "relabel"))[:4]:
            _use(bag, folder / f"{what}{number}", str(what), made)


def run_names(generator: Random, _folder: Path) -> None:
    """Ask for the classes of made-up and mutated type names."""
    letters = "abcxyzABC_019./\n\0 é/msg/"
    before = set(sys.modules)
    for _ in range(20_000):
        name = "".join(generator.choice(list(letters), generator.integers(0, 30)))
        name = _choice(
            generator, (name, f"{name}/msg/X", f"std_msgs/msg/{name}", f"{_choice(generator, sorted(before))}/msg/X")
        )
        for look_up in (message_class, message_definition):
            with suppress(UnknownTypeError):
                look_up(name)
                assert _TYPE_NAME.fullmatch(name), f"{name!r} was looked up"
    foreign = {name.partition(".")[0] for name in set(sys.modules) - before}
    assert all(name.endswith(("_msgs", "_interfaces")) for name in foreign), f"imported {sorted(foreign)}"


def _use(bag: Path, output: Path, what: str, made: Counter[tuple[str, str]]) -> None:
    done = run_limited(what, ("-c", _USE, bag, output, what), _MEMORY, _LIMIT_S)
    said = done.stderr.strip()
    assert "MemoryError" not in said, f"{what}: {said[-2000:]}"
    if done.returncode == 1:
        assert len(said) < 2500, f"{what} says {len(said)} characters"
        assert not output.exists(), f"{what} left half a bag"
        return
    found: Counter[tuple[str, str]] = Counter()
    if what == "read":
        found.update((topic, data) for topic, data in map(json.loads, done.stdout.splitlines()))
    elif what in ("copy", "recover") and output.exists():
        found.update((message.topic, message.data.hex()) for message in read_raw(output))
    if made:
        extra = found - made
        assert not extra, f"{what} made up {next(iter(extra))}"
    shutil.rmtree(output, ignore_errors=True)


def _make(generator: Random, folder: Path) -> Counter[tuple[str, str]]:
    """Write a bag and return its messages; none where they are foreign by themselves."""
    made: Counter[tuple[str, str]] = Counter()
    foreign = generator.random() < 0.3
    with BagWriter(
        folder, chunk_bytes=int(generator.integers(100, 5000)), max_file_bytes=int(generator.choice([0, 3000]))
    ) as bag:
        for name, kind in (("/odom", "nav_msgs/msg/Odometry"), ("/talk", "std_msgs/msg/String")):
            text = message_definition(kind)
            if foreign:
                kind, text = _choice(generator, _FOREIGN), _choice(generator, _DEFINITIONS)
            bag.add_topic(Topic(name, kind, text))
        for time in range(int(generator.integers(1, 60))):
            name = _choice(generator, ("/odom", "/talk"))
            data = b"\0\1\0\0" + generator.bytes(int(generator.integers(0, 800)))
            bag.write(name, data, time)
            made[name, data.hex()] += 1
    return made


def _flip(generator: Random, bag: Path) -> None:
    for _ in range(int(generator.integers(1, 4))):
        path = _some_file(generator, bag)
        data = bytearray(path.read_bytes())
        data[int(generator.integers(len(data)))] ^= 1 << int(generator.integers(8))
        path.write_bytes(data)


def _cut(generator: Random, bag: Path) -> None:
    path = _some_file(generator, bag)
    path.write_bytes(path.read_bytes()[: int(generator.integers(path.stat().st_size))])
    if generator.random() < 0.5:
        (bag / "metadata.yaml").unlink()


def _shuffle(generator: Random, bag: Path) -> None:
    """Swap parts of a file."""
    path = _some_file(generator, bag)
    data = path.read_bytes()
    cuts = sorted(int(cut) for cut in generator.integers(0, len(data) + 1, 3))
    parts = [data[begin:end] for begin, end in itertools.pairwise([0, *cuts, len(data)])]
    path.write_bytes(b"".join(parts[int(i)] for i in generator.permutation(len(parts))))


def _overwrite(generator: Random, bag: Path) -> None:
    path = _some_file(generator, bag)
    data = bytearray(path.read_bytes())
    at, size = int(generator.integers(len(data))), int(generator.integers(1, 60))
    data[at : at + size] = _choice(generator, (bytes(size), b"\xff" * size, generator.bytes(size)))
    path.write_bytes(data)


def _lie(generator: Random, bag: Path) -> None:
    """Say another number in metadata.yaml, or another kind of thing."""
    path = bag / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    information = content["rosbag2_bagfile_information"]
    value: object = _choice(generator, (-1, 2**64, 2**200, None, "x", [], {}, True, float("nan"), "../../etc/passwd"))
    where = _choice(generator, sorted(information))
    information[where] = value if generator.random() < 0.7 else [value] * 5
    path.write_text(yaml.safe_dump(content))


def _hostile_yaml(generator: Random, bag: Path) -> None:
    (bag / "metadata.yaml").write_text(_choice(generator, _YAML))


def _bomb(generator: Random, bag: Path) -> None:
    """Put a chunk that unfolds, or that claims to, at the end of a bag that was cut off."""
    size = 1 << int(generator.integers(28, 32))
    compressor = zstandard.ZstdCompressor(level=1).compressobj()
    head = struct.pack("<BQHIQQ", Opcode.MESSAGE, size - 9, 1, 0, 0, 0)
    block = bytes(1 << 22)
    parts = [compressor.compress(head), *(compressor.compress(block) for _ in range(size // len(block)))]
    data = b"".join([*parts, compressor.flush()])
    declared = int(_choice(generator, (size, 10, 1 << 62, len(head) + size)))
    content = struct.pack("<QQQII", 0, 0, declared, 0, 4) + b"zstd" + struct.pack("<Q", len(data)) + data
    path = sorted(bag.glob("*.mcap"))[-1]
    record = struct.pack("<BQ", Opcode.CHUNK, len(content)) + content
    path.write_bytes(path.read_bytes()[: -int(generator.integers(40, 400))] + record)


def _sparse(generator: Random, bag: Path) -> None:
    """Let a record claim a terabyte, and give it."""
    path = sorted(bag.glob("*.mcap"))[-1]
    with path.open("r+b") as stream:
        stream.truncate(max(60, path.stat().st_size - int(generator.integers(40, 400))))
        stream.seek(0, 2)
        stream.write(struct.pack("<BQ", int(generator.integers(1, 17)), 1 << 40))
        stream.truncate(1 << 40)


def _some_file(generator: Random, bag: Path) -> Path:
    return _choice(generator, sorted(bag.iterdir()))


def _choice(generator: Random, values: Sequence[T]) -> T:
    return values[int(generator.integers(len(values)))]


_SPOIL: tuple[Callable[[Random, Path], None], ...] = (
    _flip, _flip, _cut, _cut, _shuffle, _overwrite, _lie, _lie, _hostile_yaml, _bomb, _sparse,
)  # fmt: skip

ATTACKS = (
    Attack(
        "bags",
        "A bag of anybody is read as it was written or refused in one line, in 1.2 GB, and imports nothing.",
        run,
        limit_s=600.0,
    ),
    Attack("bags-type-names", "No type name imports anything but an installed interface package.", run_names),
)
