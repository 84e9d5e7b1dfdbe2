"""Copies of bags with additional messages."""

from pathlib import Path

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.typesys import Stores, get_typestore

from ctrl_rl_bags import BagError, BagWriter, Topic, bag_info, bag_topics, copy_bag, read_serialized, to_bag_qos

STORE = get_typestore(Stores.ROS2_JAZZY)
STRING = STORE.generate_msgdef("std_msgs/msg/String", ros_version=2)[0]
QOS = (to_bag_qos(QoSProfile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL)),)
COUNT = 50


def text(value: str) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types["std_msgs/msg/String"](value), "std_msgs/msg/String"))


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    with BagWriter(tmp_path / "bag", max_file_bytes=600, chunk_bytes=100) as writer:
        writer.add_topic(Topic("/a", "std_msgs/msg/String", STRING, "", QOS))
        writer.add_topic(Topic("/empty", "std_msgs/msg/String", STRING))
        writer.set_custom_data("digest.task", "abc")
        for i in range(COUNT):
            writer.write("/a", text(str(i)), 1000 + i, 900 + i, i + 1)
    return tmp_path / "bag"


def test_everything_is_there_again_and_what_was_added(bag: Path, tmp_path: Path) -> None:
    def add(message):
        return [("/b", text("after " + str(message.sequence)))] if message.sequence % 2 else []

    output = tmp_path / "new"
    added = [Topic("/b", "std_msgs/msg/String", STRING)]
    assert len(bag_info(bag).files) > 1
    assert copy_bag(bag, output, added, add, custom_data={"digest.grid": "def"}) == COUNT // 2
    before, after = list(read_serialized(bag)), list(read_serialized(output))
    assert [message for message in after if message.topic == "/a"] == before
    assert [(m.log_time, m.data) for m in after if m.topic == "/b"] == [
        (m.log_time, text("after " + str(m.sequence))) for m in before if m.sequence % 2
    ]
    info = bag_info(output)
    assert info.custom_data["digest.task"] == "abc"
    assert info.custom_data["digest.grid"] == "def"
    assert set(info.topics) == {"/a", "/b", "/empty"}
    assert [topic.qos for topic in bag_topics(output) if topic.name == "/a"] == [info.topics["/a"].qos]
    assert info.topics["/a"].qos[0]["durability"] == "transient_local"


def test_nothing_is_left_of_a_copy_that_fails(bag: Path, tmp_path: Path) -> None:
    def add(_message):
        raise ValueError("on purpose")

    with pytest.raises(ValueError, match="on purpose"):
        copy_bag(bag, tmp_path / "new", [], add)
    assert not (tmp_path / "new").exists()


def test_neither_a_topic_nor_a_bag_is_overwritten(bag: Path, tmp_path: Path) -> None:
    with pytest.raises(BagError, match="has a topic /a already"):
        copy_bag(bag, tmp_path / "new", [Topic("/a", "std_msgs/msg/String", STRING)], lambda _message: ())
    with pytest.raises(BagError, match="exists"):
        copy_bag(bag, bag, [], lambda _message: ())
    assert len(list(read_serialized(bag))) == COUNT


def test_a_real_sqlite3_bag_becomes_an_mcap_one(real_drive: Path, tmp_path: Path) -> None:
    copy_bag(real_drive, tmp_path / "new", [], lambda _message: ())
    before, after = bag_info(real_drive), bag_info(tmp_path / "new")
    assert after.message_count == before.message_count
    assert {name: topic.type for name, topic in after.topics.items()} == {
        name: topic.type for name, topic in before.topics.items()
    }
