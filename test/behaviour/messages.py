"""Message types for bags, read by rosbags from the definitions of the messages, whose names and fields users hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

DEFINITIONS = Path(__file__).parents[2] / "ctrl_rl_msgs" / "msg"


def _store() -> Any:
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for file in sorted(DEFINITIONS.glob("*.msg")):
        types.update(get_types_from_msg(file.read_text(encoding="utf-8"), f"ctrl_rl_msgs/msg/{file.stem}"))
    store.register(types)
    return store


STORE = _store()


def build(kind: str, **given: Any) -> Any:
    """Return a message of zeros with some fields set; a dict is a message of its own."""
    values: dict[str, Any] = {}
    for name, (node, detail) in STORE.get_msgdef(kind).fields:
        value = given.get(name)
        if node.name == "NAME":
            values[name] = build(detail, **(value or {}))
        elif value is not None:
            values[name] = value
        elif node.name == "BASE":
            values[name] = "" if detail[0] == "string" else 0
        else:
            values[name] = np.zeros(detail[1] if node.name == "ARRAY" else 0)
    return STORE.types[kind](**values)


def header(nanoseconds: int, frame: str) -> dict[str, Any]:
    """Return the fields of a header."""
    return {"stamp": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}, "frame_id": frame}


class Bag:
    """Writes an MCAP bag; a context manager.

    Args:
        folder: New folder of the bag.
        topics: Message types by topic.
    """

    def __init__(self, folder: Path, topics: dict[str, str]) -> None:
        self._writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        self._connections = {
            topic: self._writer.add_connection(topic, kind, typestore=STORE) for topic, kind in topics.items()
        }

    def put(self, topic: str, time: int, **given: Any) -> None:
        """Write a message of zeros with some fields set, logged at a time [ns]."""
        connection = self._connections[topic]
        message = build(connection.msgtype, **given)
        self.put_bytes(topic, time, STORE.serialize_cdr(message, connection.msgtype))

    def put_bytes(self, topic: str, time: int, message: bytes) -> None:
        """Write a message as it is on the wire, logged at a time [ns]."""
        self._writer.write(self._connections[topic], time, message)

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()
