"""What a bag says about itself: topics with their quality of service, and rosbag2's metadata.yaml (version 9)."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.whole_file import write_whole

METADATA_FILE = "metadata.yaml"
METADATA_VERSION = 9
ROS_DISTRO = "jazzy"
CUSTOM_DATA_RECORD = "custom_data"
"""Name of the MCAP metadata records that hold the bag's custom data, so that a bag cut off keeps them."""
NO_TIME = 2**63 - 1
"""Starting time of a bag without messages, as rosbag2 writes it."""

Qos = Mapping[str, Any]
"""One offered quality of service profile: the keys and texts that rosbag2 writes from version 9 on."""


class BagError(CtrlRlError):
    """A bag cannot be written, read or mended; the message names the file and says what to do."""


@dataclass(frozen=True)
class Topic:
    """One recorded topic.

    Attributes:
        name: full name, `/scan`.
        type: `sensor_msgs/msg/LaserScan`.
        definition: the message definition with all nested ones, as in a `ros2msg` schema.
        type_hash: `RIHS01_...` (REP-2011), empty if unknown.
        qos: what the publishers offered; it decides whether a replay is latched.
        encoding: of the definition, `ros2msg` or `ros2idl`.
    """

    name: str
    type: str
    definition: str
    type_hash: str = ""
    qos: tuple[Qos, ...] = ()
    encoding: str = "ros2msg"

    @property
    def qos_text(self) -> str:
        """The offered profiles as YAML, as they stand in the MCAP channel; empty where none is known."""
        return yaml.safe_dump(_plain(self.qos), sort_keys=False).strip() if self.qos else ""


@dataclass(frozen=True)
class FileSummary:
    """Name, log times [ns] and number of messages of one .mcap file; the times are None without messages."""

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
    """Return what stands in metadata.yaml below `rosbag2_bagfile_information`."""
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
    """Write metadata.yaml whole or not at all.

    Raises:
        OSError: the disk refuses.
    """
    content = {"rosbag2_bagfile_information": information}
    write_whole(folder / METADATA_FILE, yaml.safe_dump(content, sort_keys=False, allow_unicode=True))


def read_metadata(folder: Path) -> dict[str, Any]:
    """Return what stands in a bag's metadata.yaml below `rosbag2_bagfile_information`.

    Raises:
        BagError: there is no such file, or it is not a bag's.
    """
    path = folder / METADATA_FILE
    try:
        return dict(yaml.safe_load(path.read_text(encoding="utf-8"))["rosbag2_bagfile_information"])
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise BagError(f"{path}: cannot be read as a bag's metadata ({type(error).__name__})") from None


def _plain(qos: Sequence[Qos]) -> list[dict[str, Any]]:
    """Copy profiles so deeply that YAML finds no object twice, which it would write as an alias."""
    return [copy.deepcopy(dict(profile)) for profile in qos]
