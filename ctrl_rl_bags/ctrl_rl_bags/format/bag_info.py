"""Content of a bag according to its files, and consistency with its metadata.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ctrl_rl_bags.format.checks import BagError, printable
from ctrl_rl_bags.format.metadata import METADATA_FILE, BagMetadata, Qos, Topic, parsed_qos


@dataclass(frozen=True)
class TopicInfo:
    """Type, message count, type hash and offered QoS of one topic."""

    type: str
    message_count: int
    type_hash: str
    qos: tuple[Qos, ...]


@dataclass(frozen=True)
class BagInfo:
    """Content of a bag: log times [ns], files, topics by name, custom data, and the parts without a checksum.

    `notes` lists contradictions between metadata.yaml and the files; the files take precedence.
    """

    folder: Path
    start: int
    end: int
    message_count: int
    files: tuple[str, ...]
    topics: Mapping[str, TopicInfo]
    custom_data: Mapping[str, str]
    unchecked: str = ""
    notes: tuple[str, ...] = ()


def is_bag_file(path: Path) -> bool:
    """Return whether a file name is that of a bag file."""
    return path.suffix in (".mcap", ".db3")


def recover_hint(bag: Path | str) -> str:
    """Return advice to use `bag recover`, for the end of an error message; empty if that cannot help."""
    path = Path(bag)
    mendable = any(map(is_bag_file, path.iterdir())) if path.is_dir() else is_bag_file(path)
    return f"; recover it with ros2 run ctrl_rl_bags bag recover {path}" if mendable else ""


def completed(topic: Topic, offered: Mapping[str, Any]) -> Topic:
    """Fill in type hash and QoS from metadata.yaml where another writer's file lacks them."""
    also = offered.get(topic.name)
    if also is None:
        return topic
    qos = topic.qos or parsed_qos(also.offered_qos_profiles)
    return replace(topic, type_hash=topic.type_hash or also.type_description_hash, qos=qos)


def compare(metadata: BagMetadata, info: BagInfo, mixed: Mapping[str, str]) -> list[str]:
    """Return harmless differences between metadata.yaml and the files, one line each.

    Foxy and Humble store only the times of the last split; `ros2 bag reindex` drops empty topics.

    Raises:
        BagError: Messages are missing or have another type, so the files do not belong to this bag.
    """
    said = {
        it.topic_metadata.name: (it.topic_metadata.type, it.message_count) for it in metadata.topics_with_message_count
    }
    found = {name: (topic.type, topic.message_count) for name, topic in info.topics.items()}
    differ = [name for name in sorted(said.keys() | found.keys()) if said.get(name) != found.get(name)]
    empty = [name for name in differ if said.get(name, ("", 0))[1] == found.get(name, ("", 0))[1] == 0]
    wrong = next((name for name in differ if name not in empty), None)
    notes = [f"only one of {METADATA_FILE} and the files names {printable(name)}, without messages" for name in empty]
    if wrong in mixed:
        return notes
    if wrong is not None:
        words = [
            f"{kind}, {count} messages" if kind else "no such topic"
            for kind, count in (said.get(wrong, ("", 0)), found.get(wrong, ("", 0)))
        ]
        fault = f"{wrong}: {words[0]}; its files: {words[1]}"
        raise BagError(f"{info.folder}: {METADATA_FILE} says {printable(fault)}{recover_hint(info.folder)}")
    if metadata.message_count != info.message_count:
        fault = f"{metadata.message_count} messages; its files: {info.message_count}"
        raise BagError(f"{info.folder}: {METADATA_FILE} says {printable(fault)}{recover_hint(info.folder)}")
    times = metadata.starting_time.nanoseconds_since_epoch, metadata.duration.nanoseconds
    if info.message_count and times != (info.start, info.end - info.start):
        notes.append(f"{METADATA_FILE} says other times than the files")
    return notes
