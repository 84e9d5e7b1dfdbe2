"""What a bag tells about its run: nodes' parameters, lost messages, latency from a message to its answer."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.io import parse_json
from numpy.typing import NDArray

from ctrl_rl_bags import read_serialized
from ctrl_rl_core import CtrlRlError


def recorded_parameters(custom_data: Mapping[str, str], node: str) -> dict[str, Any]:
    """Return a node's recorded parameters, in any namespace; empty if they are missing or damaged."""
    keys = (key for key in custom_data if key.startswith("parameters.") and key.endswith(f"/{node}"))
    try:
        content = parse_json(custom_data.get(min(keys, default=""), "{}"))
    except CtrlRlError:
        return {}
    return content if isinstance(content, dict) else {}


_CDR_HEADER = 4
_STAMP = struct.Struct("<iI")


class Sent(NamedTuple):
    """One recorded message: the publisher's count, when it was published [ns], and the stamp in its header [ns].

    The stamp is valid for messages that begin with a std_msgs/Header.
    """

    sequence: int
    publish_time: int
    stamp: int


def read_sent(bag: Path) -> dict[str, list[Sent]]:
    """Return the messages of a bag, by topic."""
    out: dict[str, list[Sent]] = defaultdict(list)
    for message in read_serialized(bag):
        out[message.topic].append(Sent(message.sequence, message.publish_time, _stamp(message.data)))
    return out


def lost_messages(sent: Mapping[str, list[Sent]]) -> int:
    """Return how many sequence numbers are missing on topics with one publisher."""
    missing = 0
    for messages in sent.values():
        numbers = [message.sequence for message in messages]
        one_publisher = len(set(numbers)) == len(numbers)
        if one_publisher and min(numbers) > 0:
            missing += max(numbers) - min(numbers) + 1 - len(numbers)
    return missing


def answer_latencies(questions: Iterable[Sent], answers: Iterable[Sent]) -> NDArray[np.float64]:
    """Return the times (n,) [s] from publishing a question to publishing the first answer with its stamp.

    Unprompted messages, such as a watchdog's zero in a paused world, may carry the stamp of an old question.
    """
    asked = {question.stamp: question.publish_time for question in questions}
    times = []
    for answer in answers:
        at = asked.pop(answer.stamp, None)
        if at is not None:
            times.append(answer.publish_time - at)
    return 1e-9 * np.array(times, dtype=float)


def late_answers(questions: Iterable[Sent], answers: Iterable[Sent]) -> int:
    """Return the number of questions that were answered after the next one had been published.

    A simulator that runs faster than its computer allows asks again before the answer is there: such a drive depends
    on the load of the computer.
    """
    asked = sorted(questions, key=lambda each: each.publish_time)
    following = {each.stamp: after.publish_time for each, after in pairwise(asked)}
    late = 0
    for answer in answers:
        at = following.pop(answer.stamp, None)
        late += at is not None and answer.publish_time > at
    return late


def _stamp(data: bytes) -> int:
    if len(data) < _CDR_HEADER + _STAMP.size:
        return 0
    seconds, nanoseconds = _STAMP.unpack_from(data, _CDR_HEADER)
    return int(seconds * 10**9 + nanoseconds)
