"""How many messages the bag writer takes per CPU-second, against the mcap library's own writer."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from _common import Row, row
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

from ctrl_rl_bags import BagWriter, Topic

TYPE = "sensor_msgs/msg/LaserScan"
MESSAGES = 15_000
ROUNDS = 3


def rows() -> list[Row]:
    """Return one row a kind of scan: a room with sensor noise in whole millimetres, and one scan over and over."""
    store = get_typestore(Stores.ROS2_JAZZY)
    topic = Topic("/scan", TYPE, store.generate_msgdef(TYPE, ros_version=2)[0], store.hash_rihs01(TYPE))
    out: list[Row] = []
    for name, distinct in (("noisy scans", MESSAGES), ("one scan repeated", 1)):
        scans = _scans(distinct)
        # In turn and the best of each, so that another process' load weighs on both alike.
        ours, peer = 0.0, 0.0
        for _ in range(ROUNDS):
            ours = max(ours, _bag_writer(topic, scans))
            peer = max(peer, _mcap_writer(topic, scans))
        against = f"mcap.writer.Writer, zstd, 1 MiB chunks: {round(peer)}"
        name = f"bag writer, 2.9 kB LaserScan, {name}"
        out.append(row(name, round(ours), "messages per CPU-second", against, ours / peer))
    return out


def _scans(count: int) -> list[bytes]:
    """Return CDR messages of 720 beams: header, seven numbers, ranges, no intensities."""
    rng = np.random.default_rng(0)
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    walls = 2.0 + np.cumsum(rng.normal(0.0, 0.02, 720))
    out = []
    for i in range(count):
        header = types["std_msgs/msg/Header"](
            types["builtin_interfaces/msg/Time"](i // 10, i % 10 * 10**8), "base_scan"
        )
        ranges = np.round(walls + rng.normal(0.0, 0.01, 720), 3).astype(np.float32)
        scan = types[TYPE](header, 0.0, 6.28, 0.0087, 0.0, 0.1, 0.12, 3.5, ranges, np.empty(0, np.float32))
        out.append(bytes(store.serialize_cdr(scan, TYPE)))
    return out


def _bag_writer(topic: Topic, scans: Sequence[bytes]) -> float:
    with tempfile.TemporaryDirectory() as folder:
        begin = time.process_time()
        with BagWriter(Path(folder) / "bag") as bag:
            bag.add_topic(topic)
            for i in range(MESSAGES):
                bag.write("/scan", scans[i % len(scans)], i * 1000, i * 1000, i)
        return MESSAGES / (time.process_time() - begin)


def _mcap_writer(topic: Topic, scans: Sequence[bytes]) -> float:
    with tempfile.TemporaryDirectory() as folder, (Path(folder) / "peer.mcap").open("wb") as file:
        begin = time.process_time()
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema(topic.type, "ros2msg", topic.definition.encode())
        channel = writer.register_channel(topic.name, "cdr", schema)
        for i in range(MESSAGES):
            writer.add_message(channel, i * 1000, scans[i % len(scans)], i * 1000, i)
        writer.finish()  # type: ignore[no-untyped-call]
        return MESSAGES / (time.process_time() - begin)


if __name__ == "__main__":
    for row in rows():
        print(f"{row['name']}: {row['value']} {row['unit']}, ratio {row['ratio']} ({row['against']})")
