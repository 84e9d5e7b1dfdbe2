"""Topics and messages as the files of a bag hold them."""

from __future__ import annotations

from typing import Any, NamedTuple

from mcap.records import Channel, Schema
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from ctrl_rl_bags.format.checks import DamagedError, parse_yaml
from ctrl_rl_bags.format.metadata import Qos, Topic


class SerializedMessage(NamedTuple):
    """One message as it was on the wire: times [ns since the epoch], the publisher's count, CDR bytes.

    An sqlite3 bag knows neither publication times nor counts: there they are the log time and 0.
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
        DamagedError: The message definition is no text.
    """
    schema = schema or Schema(id=0, data=b"", encoding="", name="")
    try:
        definition = schema.data.decode()
    except UnicodeDecodeError:
        raise DamagedError("a message definition is no text") from None
    return Topic(
        name=channel.topic,
        type=schema.name,
        definition=definition,
        type_hash=channel.metadata.get("topic_type_hash", ""),
        qos=parsed_qos(channel.metadata.get("offered_qos_profiles", "")),
        encoding=schema.encoding,
    )


def parsed_qos(profiles: Any) -> tuple[Qos, ...]:
    """Return the QoS profiles that publishers offered, in the words of metadata version 9; none if they make no sense.

    Args:
        profiles: YAML text, or its content.
    """
    try:
        return tuple(dump_qos_v9(parse_qos(parse_yaml(profiles) if isinstance(profiles, str) else profiles)))
    except Exception:  # a bag with wrong QoS profiles can still be read
        return ()
