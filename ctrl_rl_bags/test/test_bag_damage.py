"""Damaged and malicious bags: rejected with a one-line error, within resource limits, or fully recovered."""

import os
import shutil
import struct
from dataclasses import dataclass
from pathlib import Path

import lz4.frame
import pytest
import yaml
import zstandard
from bag_messages import LATCHED, STORE, cdr, odometry, text, topic, write_texts
from ctrl_rl_bags.format.mcap_writer import MAGIC
from ctrl_rl_bags.format.type_definitions import BagTypes, Definition
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from ctrl_rl_bags import (
    BagError,
    BagWriter,
    Limits,
    Topic,
    bag_info,
    copy_bag,
    open_bag,
    read_messages,
    read_serialized,
    recover,
)

pytestmark = pytest.mark.fault
MEMORY = 1 << 30


@dataclass(repr=False)
class Sound:
    """Intact bag with its messages and metadata."""

    folder: Path
    messages: list
    info: tuple


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Bag of two types in several chunks, with all of its metadata and messages."""
    folder = tmp_path_factory.mktemp("sound") / "bag"
    with BagWriter(folder, chunk_bytes=900) as bag:
        bag.add_topic(topic("/odom", "nav_msgs/msg/Odometry"))
        bag.add_topic(topic("/talk", "std_msgs/msg/String", (LATCHED,)))
        bag.set_custom_data("digest.task", "0123")
        for i in range(6):
            bag.write("/odom", cdr(odometry(i, i, 0.0, 0.0)), i, i, i)
            bag.write("/talk", text(str(i)), i, i, i)
    return Sound(folder, list(read_serialized(folder)), contents(bag_info(folder)))


def contents(info):
    return info.start, info.end, info.message_count, info.files, info.topics, info.custom_data


def outcome(read):
    """Return a reader's findings and its reason for rejecting the bag."""
    try:
        return read(), ""
    except BagError as error:
        return None, str(error)


@settings(max_examples=150, deadline=None)
@given(where=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7), file=st.sampled_from(["mcap", "yaml"]))
def test_a_flipped_bit_is_refused_or_changes_nothing(sound, tmp_path_factory, where, bit, file):
    folder = tmp_path_factory.mktemp("flipped") / "bag"
    shutil.copytree(sound.folder, folder)
    path = folder / ("bag_0.mcap" if file == "mcap" else "metadata.yaml")
    data = bytearray(path.read_bytes())
    data[int(where * len(data))] ^= 1 << bit
    path.write_bytes(data)
    for read, expected in (
        (lambda: contents(bag_info(folder)), sound.info),
        (lambda: list(read_serialized(folder)), sound.messages),
    ):
        found, refusal = outcome(read)
        assert "\n" not in refusal
        same = found == expected
        assert same or "bag recover" in refusal
    shutil.rmtree(folder.parent)


def test_a_flipped_chunk_is_not_copied(sound, tmp_path):
    folder = tmp_path / "bag"
    shutil.copytree(sound.folder, folder)
    data = bytearray((folder / "bag_0.mcap").read_bytes())
    data[data.index(b"\x28\xb5\x2f\xfd") + 60] ^= 4
    (folder / "bag_0.mcap").write_bytes(data)
    with pytest.raises(BagError, match=r"checksum|decompressed"):
        copy_bag(folder, tmp_path / "copy", [], lambda _message: ())
    assert not (tmp_path / "copy").exists()


def test_what_no_checksum_covers_is_said(tmp_path):
    with (tmp_path / "bag.mcap").open("wb") as stream:
        writer = Writer(stream, enable_crcs=False)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        writer.add_message(writer.register_channel("/talk", "cdr", schema), 1, text("hi"), 1)
        writer.finish()
    assert bag_info(tmp_path / "bag.mcap").unchecked == "messages, topics and times"
    assert bag_info(write_texts(tmp_path / "ours")).unchecked == ""


@pytest.mark.parametrize("options", [{}, {"use_chunking": False}, {"index_types": 0}, {"repeat_channels": False}])
def test_files_of_other_writers(tmp_path, options):
    from mcap.writer import IndexType

    if "index_types" in options:
        options = {"index_types": IndexType.NONE}
    with (tmp_path / "bag.mcap").open("wb") as stream:
        writer = Writer(stream, chunk_size=200, compression=CompressionType.LZ4, **options)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/talk", "cdr", schema)
        for i in range(50):
            writer.add_message(channel, 10 + i, text(str(i)), 10 + i, i)
        writer.finish()
    assert [m.data.data for m in read_messages(tmp_path / "bag.mcap")] == [str(i) for i in range(50)]
    assert [m.log_time for m in read_messages(tmp_path / "bag.mcap", start=20, stop=30)] == list(range(20, 30))
    assert bag_info(tmp_path / "bag.mcap").message_count == 50


def chunk(size, compressed, compression, start=0, end=0):
    content = struct.pack("<QQQI", start, end, size, 0) + struct.pack("<I", len(compression)) + compression
    return content + struct.pack("<Q", len(compressed)) + compressed


def with_chunk(folder, content):
    """Build a truncated bag whose last record is this chunk."""
    write_texts(folder, count=1)
    file = folder / f"{folder.name}_0.mcap"
    data = file.read_bytes()
    end = data.index(b"\x28\xb5\x2f\xfd") - 9 - 40 - 4
    file.write_bytes(data[:end] + struct.pack("<BQ", 6, len(content)) + content)
    (folder / "metadata.yaml").unlink()


def zstd_bomb(size):
    compressor, head = zstandard.ZstdCompressor(level=1).compressobj(), struct.pack("<BQHIQQ", 5, size - 9, 1, 0, 0, 0)
    parts = [compressor.compress(head)]
    left, block = size - len(head), bytes(1 << 24)
    while left > 0:
        parts.append(compressor.compress(block[:left]))
        left -= len(block)
    return b"".join([*parts, compressor.flush()])


@pytest.fixture
def bounded(in_turn):
    """Return a function that runs bag commands with little memory and returns the exit code and output of each."""

    def run(*commands):
        ends = in_turn("ctrl_rl_bags.cli", [list(map(str, command)) for command in commands], MEMORY)
        assert all(len(errors.strip().splitlines()) <= 1 for _, errors, _ in ends), ends
        return [(code, errors + output) for code, errors, output in ends]

    return run


def test_a_chunk_that_unfolds_is_left_out(tmp_path, bounded):
    bombs = {b"zstd": zstd_bomb(2 << 30), b"lz4": lz4.frame.compress(bytes(1 << 28))}
    folders = []
    for declared in (100, 1 << 31, 1 << 62):
        for compression, bomb in bombs.items():
            folders.append(tmp_path / f"{compression.decode()}-{declared}")
            with_chunk(folders[-1], chunk(declared, bomb, compression))
    for code, said in bounded(*(("recover", folder) for folder in folders)):
        assert code == 1
        assert "holds no readable message" in said


def test_a_record_of_a_terabyte(tmp_path, bounded):
    opcodes = (3, 5, 6, 12)
    for opcode in opcodes:
        folder = tmp_path / str(opcode)
        with_chunk(folder, chunk(0, b"", b""))
        file = folder / f"{opcode}_0.mcap"
        with file.open("r+b") as stream:
            stream.seek(0, os.SEEK_END)
            stream.write(struct.pack("<BQ", opcode, 1 << 40))
            stream.truncate(1 << 40)
    assert [code for code, _ in bounded(*(("recover", tmp_path / str(opcode)) for opcode in opcodes))] == [1] * 4


def overlapping(path, count, size):
    """Write a file whose chunks all start at 0."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=size // 2, compression=CompressionType.ZSTD)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/talk", "cdr", schema)
        for i in range(count):
            writer.add_message(channel, 0, bytes(size // 2 - 100), 0)
            writer.add_message(channel, 10 + i, bytes(200), 0)
        writer.finish()


def test_chunks_over_each_other_do_not_all_lie_in_memory(tmp_path):
    overlapping(tmp_path / "bag.mcap", 5, 10_000)
    limits = Limits(open_bytes=12_000)
    with open_bag(tmp_path / "bag.mcap", limits) as bag, pytest.raises(BagError, match="its chunks overlap"):
        list(bag.messages())
    with open_bag(tmp_path / "bag.mcap") as bag:
        times = [message.log_time for message in bag.messages()]
    assert times == [0] * 5 + [10, 11, 12, 13, 14]


def test_a_larger_chunk_is_read_when_asked_for(tmp_path, bounded):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic(topic("/talk", "std_msgs/msg/String"))
        bag.write("/talk", bytes(3 << 20), 1)
    commands = [("recover", tmp_path / "bag", "--max-chunk-mb", size) for size in (1, 4)]
    (code, said), (enough, _) = bounded(*commands)
    assert (code, enough) == (1, 0)
    assert "larger than --max-chunk-mb" in said
    # The error names the command that makes smaller chunks.
    advice = f"recover it with ros2 run ctrl_rl_bags bag recover {tmp_path / 'bag'} --max-chunk-mb 4$"
    with open_bag(tmp_path / "bag", Limits(chunk_bytes=1 << 20)) as opened, pytest.raises(BagError, match=advice):
        list(opened.messages())


def aliases(levels):
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)]
    return "\n".join(lines)


HOSTILE = (
    (aliases(12), "it has an alias"),
    ("[" * 10_000, "nested more than 20 levels"),
    ("x" * (9 << 20), "is too large"),
    ("rosbag2_bagfile_information: 7\n", "not a bag's metadata"),
    ("- 1\n", "not a bag's metadata"),
    ("!!python/object/apply:os.getcwd []\n", "not YAML"),
    ("\0", "not YAML"),
    ("", "not a bag's metadata"),
)


def test_hostile_metadata(tmp_path, bounded):
    folders = [write_texts(tmp_path / str(number)) for number in range(len(HOSTILE))]
    for folder, (content, _) in zip(folders, HOSTILE, strict=True):
        (folder / "metadata.yaml").write_text(content)
    ends = bounded(*(("info", folder) for folder in folders))
    for (code, said), (_, words) in zip(ends, HOSTILE, strict=True):
        assert (code, words in said) == (1, True), said


def test_a_pipe_is_no_bag(tmp_path, bounded):
    folders = [write_texts(tmp_path / name) for name in ("described", "data", "cut")]
    for folder, name in zip(folders, ("metadata.yaml", "data_0.mcap", "cut_0.mcap"), strict=True):
        (folder / name).unlink()
        os.mkfifo(folder / name)
    (folders[2] / "metadata.yaml").unlink()
    os.mkfifo(tmp_path / "pipe.mcap")
    read, *rest = bounded(
        ("info", folders[0]), ("info", folders[1]), ("recover", folders[2]), ("info", tmp_path / "pipe.mcap")
    )
    for code, said in (read, rest[0]):
        assert (code, "no regular file" in said) == (1, True)
    assert [code for code, _ in rest[1:]] == [1, 1]


def change(folder, **changes):
    path = folder / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    content["rosbag2_bagfile_information"].update(changes)
    path.write_text(yaml.safe_dump(content))


def test_metadata_must_say_what_the_files_say(tmp_path):
    for number, (changes, words) in enumerate(
        [
            ({"message_count": 41}, "41 messages; its files: 40"),
            ({"topics_with_message_count": []}, "/talk: no such topic; its files: std_msgs/msg/String, 40 messages"),
            ({"custom_data": {"digest.task": "9999"}}, "other custom data"),
            ({"version": 10}, "version"),
        ]
    ):
        folder = write_texts(tmp_path / str(number))
        change(folder, **changes)
        with pytest.raises(BagError, match=words):
            bag_info(folder)
    assert recover(tmp_path / "0").messages == {"/talk": 40}


def test_two_types_on_a_topic_are_told_apart(tmp_path):
    with (tmp_path / "bag.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        for i, kind in enumerate(("String", "Empty")):
            schema = writer.register_schema(f"std_msgs/msg/{kind}", "ros2msg", [b"string data\n", b""][i])
            writer.add_message(writer.register_channel("/talk", "cdr", schema), i, text(str(i)), i)
        writer.finish()
    with pytest.raises(BagError, match=r"two types, std_msgs/msg/String and std_msgs/msg/Empty; recover it with"):
        list(read_serialized(tmp_path / "bag.mcap"))
    found = recover(tmp_path / "bag.mcap")
    assert found.messages == {"/talk": 1, "/talk/as/std_msgs/Empty": 1}
    assert bag_info(found.folder).topics["/talk/as/std_msgs/Empty"].type == "std_msgs/msg/Empty"


def test_one_file_can_be_recovered(tmp_path):
    folder = write_texts(tmp_path / "bag")
    file = folder / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-50])
    assert recover(file, tmp_path / "out").messages == {"/talk": 40}
    assert len(list(read_serialized(tmp_path / "out"))) == 40


@pytest.mark.parametrize(
    ("definition", "words"),
    [
        ("a/msg/Self me\n" + "=" * 80 + "\nMSG: a/Self\na/msg/Self me\n", "levels deep|not defined"),
        ("string[1000000000] x\n", "array of 1,000,000,000"),
        ("uint8[0] x\n", "array of 0 elements"),
        ("float64[-1] x\n", "array of -1"),
        ("int32 x\n" * 100_000, "characters"),
        ("nowhere_msgs/Odd x\n", "not defined"),
        ("\0\1\2", "cannot be read"),
        ("int32 x\nint32 x\n", "cannot be used"),
        ("__import__('os') x\n", "cannot be read"),
    ],
)
def test_hostile_definitions(tmp_path, definition, words):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic(Topic("/evil", "a/msg/B", definition))
        bag.write("/evil", bytes(64), 1)
    with pytest.raises(BagError, match=words) as told:
        list(read_messages(tmp_path / "bag"))
    assert "\n" not in str(told.value)
    assert bag_info(tmp_path / "bag").message_count == 1  # what it holds can still be said


def test_a_wrong_type_hash_is_refused(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        hashed = STORE.hash_rihs01("std_msgs/msg/String")
        bag.add_topic(Topic("/talk", "std_msgs/msg/String", "string date\n", hashed))
        bag.write("/talk", text("hi"), 1)
    with pytest.raises(BagError, match="not the one of its type hash"):
        list(read_messages(tmp_path / "bag"))


def test_a_message_does_not_unfold_to_millions_of_objects():
    separator = "=" * 80
    nested = f"a/C[] c\n{separator}\nMSG: a/C\na/D d\n{separator}\nMSG: a/D\nbool x\n"
    types = BagTypes([Definition("a/msg/B", nested, "ros2msg", "")])
    few = struct.pack("<II", 0x100, 1000) + bytes(1000)
    assert len(types.decode(few, "a/msg/B").c) == 1000
    with pytest.raises(BagError, match="may expand"):
        types.decode(struct.pack("<II", 0x100, 10_000_000) + bytes(10_000_000), "a/msg/B")


ODOMETRY = BagTypes([Definition("nav_msgs/msg/Odometry", "", "", "")])


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=200))
def test_no_bytes_are_a_message_by_force(data):
    assert "\n" not in outcome(lambda: ODOMETRY.decode(data, "nav_msgs/msg/Odometry"))[1]


def test_a_header_of_another_kind(tmp_path):
    path = tmp_path / "bag.mcap"
    for content, words in ((b"", "empty"), (MAGIC, "beyond the end"), (b"x" * 100, "not an MCAP file")):
        path.write_bytes(content)
        with pytest.raises(BagError, match=words):
            bag_info(path)


def test_a_chunk_that_is_in_the_index_twice(tmp_path):
    path = write_texts(tmp_path / "bag") / "bag_0.mcap"
    data = path.read_bytes()
    opcode, size, start, offsets, _ = struct.unpack_from("<BQQQI", data, len(data) - 37)
    at = start
    while data[at] != 8:  # the first chunk index
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    record = data[at : at + 9 + struct.unpack_from("<Q", data, at + 1)[0]]
    footer = struct.pack("<BQQQI", opcode, size, start, offsets + 1000 * len(record), 0)
    path.write_bytes(data[:at] + 1000 * record + data[at:-37] + footer + MAGIC)
    with pytest.raises(BagError, match="a chunk twice"):
        bag_info(path)
