"""Copies a bag message by message, byte for byte, optionally with additional messages."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from ctrl_rl_bags.format.checks import BagError
from ctrl_rl_bags.format.metadata import SerializedMessage, Topic
from ctrl_rl_bags.format.reader import Bag, bag_info, open_bag
from ctrl_rl_bags.format.writer import BagWriter


def read_serialized(bag: Path | str) -> Iterator[SerializedMessage]:
    """Yield every message of a bag, file by file in log-time order.

    sqlite3 bags store neither publication time nor sequence number; the log time and 0 are used instead.

    Raises:
        BagError: The bag cannot be read, or a checksum is wrong.
    """
    with open_bag(bag) as opened:
        opened.check()
        yield from opened.messages()


def bag_topics(bag: Path | str | Bag) -> list[Topic]:
    """Return the topics of a bag with their definitions and QoS.

    Raises:
        BagError: The bag cannot be read, or a type is neither defined in it nor part of ROS 2 Jazzy.
    """
    out = []
    with open_bag(bag) as opened:
        for topic in opened.topics.values():
            if not topic.definition:  # bags that predate MCAP name their types but do not define them
                text = opened.types([topic.name]).store.generate_msgdef(topic.type, ros_version=2)[0]
                topic = replace(topic, definition=text, encoding="ros2msg")
            out.append(topic)
    return out


def copy_bag(
    bag: Path | str,
    output: Path | str,
    added: Sequence[Topic],
    add: Callable[[SerializedMessage], Iterable[tuple[str, bytes]]],
    *,
    left_out: Collection[str] = (),
    custom_data: Mapping[str, str] | None = None,
    progress: str = "",
) -> int:
    """Copy a bag and add topics; the retained messages are unchanged, byte for byte.

    Args:
        bag: Folder or file.
        output: Folder of the new bag, which must not exist.
        added: Topics to add.
        add: Returns the messages (topic, CDR bytes) to insert after each copied message, with the same times.
        left_out: Topics to omit.
        custom_data: Custom data to add to the old bag's.
        progress: Label of a progress bar on a terminal; empty for no bar.

    Returns:
        Number of messages added.

    Raises:
        BagError: The bag cannot be read or already has one of the topics, or the output exists.
    """
    topics, info = [topic for topic in bag_topics(bag) if topic.name not in left_out], bag_info(bag)
    twice = {topic.name for topic in topics} & {topic.name for topic in added}
    if twice:
        raise BagError(f"{bag} has a topic {min(twice)} already")
    count = 0
    with BagWriter(output) as writer:
        try:
            for topic in (*topics, *added):
                writer.add_topic(topic)
            for key, value in (*info.custom_data.items(), *(custom_data or {}).items()):
                writer.set_custom_data(key, value)
            messages = tqdm(read_serialized(bag), progress, info.message_count, disable=None if progress else True)
            for message in messages:
                if message.topic in left_out:
                    continue
                writer.write(message.topic, message.data, message.log_time, message.publish_time, message.sequence)
                for name, data in add(message):
                    writer.write(name, data, message.log_time, message.publish_time)
                    count += 1
        except BaseException:
            with suppress(BagError):
                writer.close()
            shutil.rmtree(writer.folder, ignore_errors=True)
            raise
    return count
