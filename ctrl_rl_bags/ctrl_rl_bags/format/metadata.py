"""Metadata of a bag: topics with QoS, and rosbag2's metadata.yaml (version 9)."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import yaml
from mcap.records import Channel, Schema
from pydantic import BaseModel, Field, ValidationError
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from ctrl_rl_bags.format.checks import BagError, DamagedError, parse_yaml, printable, read_yaml, reason
from ctrl_rl_core import atomic_write

METADATA_FILE = "metadata.yaml"
METADATA_VERSION = 9
ROS_DISTRO = "jazzy"
CUSTOM_DATA_RECORD = "custom_data"
"""Name of the MCAP metadata records with the bag's custom data; incomplete bags keep them."""
NO_TIME = 2**63 - 1
"""Start time of a bag without messages, as written by rosbag2."""

Qos = Mapping[str, Any]
"""One offered QoS profile, with rosbag2's keys and values since version 9."""


class _Nanoseconds(BaseModel):
    nanoseconds: Annotated[int, Field(ge=0, lt=2**64)]


class _StartingTime(BaseModel):
    nanoseconds_since_epoch: Annotated[int, Field(ge=0, lt=2**64)]


class _TopicMetadata(BaseModel):
    name: str
    type: str
    serialization_format: str = "cdr"
    offered_qos_profiles: list[Any] | str = ""
    type_description_hash: str = ""


class _TopicCount(BaseModel):
    topic_metadata: _TopicMetadata
    message_count: Annotated[int, Field(ge=0, lt=2**63)]


class BagMetadata(BaseModel):
    """The keys read from metadata.yaml (versions 1 to 9), under rosbag2's names."""

    version: Annotated[int, Field(ge=1, le=METADATA_VERSION)]
    storage_identifier: Literal["mcap", "sqlite3", ""]
    relative_file_paths: list[str]
    duration: _Nanoseconds
    starting_time: _StartingTime
    message_count: Annotated[int, Field(ge=0, lt=2**63)]
    topics_with_message_count: list[_TopicCount]
    compression_format: str | None = ""
    compression_mode: str | None = ""
    custom_data: dict[str, str] | None = None


@dataclass(frozen=True)
class Topic:
    """One recorded topic.

    Attributes:
        name: Full name, `/scan`.
        type: Name of the message type, e.g. `sensor_msgs/msg/LaserScan`.
        definition: Message definition with all nested ones, as in a `ros2msg` schema.
        type_hash: `RIHS01_...` (REP-2011); empty if unknown.
        qos: QoS profiles of the publishers, which determine whether a replay is latched.
        encoding: Language of the definition, `ros2msg` or `ros2idl`.
    """

    name: str
    type: str
    definition: str
    type_hash: str = ""
    qos: tuple[Qos, ...] = ()
    encoding: str = "ros2msg"

    @property
    def qos_text(self) -> str:
        """Offered profiles as YAML, as in the MCAP channel; empty if unknown."""
        return yaml.safe_dump(_plain(self.qos), sort_keys=False).strip() if self.qos else ""


def name_of_other_type(topic: str, kind: str) -> str:
    """Return the name for messages with a type other than their topic's first type.

    rosbag2 allows one type per topic.
    """
    return f"{topic}/as/{kind.replace('/msg/', '/')}"


@dataclass(frozen=True)
class FileSummary:
    """Name, log times [ns] and message count of one .mcap file; the times are None without messages."""

    path: str
    start: int | None
    end: int | None
    message_count: int


def bag_information(
    files: Sequence[FileSummary],
    topics: Iterable[Topic],
    counts: Mapping[str, int],
    custom_data: Mapping[str, str],
) -> dict[str, Any]:
    """Return the content of metadata.yaml below `rosbag2_bagfile_information`."""
    starts = [file.start for file in files if file.start is not None]
    ends = [file.end for file in files if file.end is not None]
    return {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": max(ends) - min(starts) if starts else 0},
        "starting_time": {"nanoseconds_since_epoch": min(starts) if starts else NO_TIME},
        "message_count": sum(file.message_count for file in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": _plain(topic.qos),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": counts.get(topic.name, 0),
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.path for file in files],
        "files": [
            {
                "path": file.path,
                "starting_time": {"nanoseconds_since_epoch": NO_TIME if file.start is None else file.start},
                "duration": {"nanoseconds": 0 if file.start is None or file.end is None else file.end - file.start},
                "message_count": file.message_count,
            }
            for file in files
        ],
        "custom_data": dict(custom_data),
        "ros_distro": ROS_DISTRO,
    }


def write_metadata(folder: Path, information: Mapping[str, Any]) -> None:
    """Write metadata.yaml atomically.

    Raises:
        OSError: Writing fails.
    """
    content = {"rosbag2_bagfile_information": information}
    atomic_write(folder / METADATA_FILE, yaml.safe_dump(content, sort_keys=False, allow_unicode=True))


def read_metadata(folder: Path) -> BagMetadata:
    """Return the content of a bag's metadata.yaml below `rosbag2_bagfile_information`.

    Raises:
        BagError: The file is missing, or is not the metadata of a bag.
    """
    path = folder / METADATA_FILE
    try:
        content = read_yaml(path)
        information = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
        return BagMetadata.model_validate(information)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise BagError(f"{path} is not a bag's metadata: {printable(where)}: {printable(first['msg'])}") from None
    except (OSError, DamagedError) as error:
        raise BagError(f"{path} cannot be read: {reason(error)}") from None


def _plain(qos: Sequence[Qos]) -> list[dict[str, Any]]:
    """Deep-copy profiles, so that YAML never sees the same object twice and writes no alias."""
    return [copy.deepcopy(dict(profile)) for profile in qos]


class SerializedMessage(NamedTuple):
    """One serialised message: times [ns since the epoch], the publisher's sequence number, CDR bytes.

    sqlite3 bags store neither publication time nor sequence number; the log time and 0 are used instead.
    """

    topic: str
    type: str
    log_time: int
    publish_time: int
    sequence: int
    data: bytes


def mcap_topic(channel: Channel, schema: Schema | None) -> Topic:
    """Return the topic of an MCAP channel; its type is empty without a schema.

    Raises:
        DamagedError: The message definition is not text.
    """
    schema = schema or Schema(id=0, data=b"", encoding="", name="")
    try:
        definition = schema.data.decode()
    except UnicodeDecodeError:
        raise DamagedError("a message definition is not text") from None
    return Topic(
        name=channel.topic,
        type=schema.name,
        definition=definition,
        type_hash=channel.metadata.get("topic_type_hash", ""),
        qos=parsed_qos(channel.metadata.get("offered_qos_profiles", "")),
        encoding=schema.encoding,
    )


def parsed_qos(profiles: Any) -> tuple[Qos, ...]:
    """Convert offered QoS profiles to metadata version 9; empty if they cannot be parsed.

    Args:
        profiles: YAML text, or its content.
    """
    try:
        return tuple(dump_qos_v9(parse_qos(parse_yaml(profiles) if isinstance(profiles, str) else profiles)))
    except Exception:  # a bag with invalid QoS profiles is still readable
        return ()
