"""Bags: what a run leaves behind and what is trained on again.

The public names of the modules `bag_writer`, `bag_reader`, `bag_recovery` and `alignment`.
"""

from ctrl_rl_core.alignment import Aligned, Extractor, Scan, Track, align, sample
from ctrl_rl_core.bag_door import BagError
from ctrl_rl_core.bag_metadata import Qos, Topic
from ctrl_rl_core.bag_reader import (
    BagInfo,
    BagMessage,
    RawMessage,
    TopicInfo,
    bag_info,
    open_bag,
    read_messages,
    read_raw,
)
from ctrl_rl_core.bag_recovery import Recovery, recover
from ctrl_rl_core.bag_writer import BagWriter

__all__ = [
    "Aligned",
    "BagError",
    "BagInfo",
    "BagMessage",
    "BagWriter",
    "Extractor",
    "Qos",
    "RawMessage",
    "Recovery",
    "Scan",
    "Topic",
    "TopicInfo",
    "Track",
    "align",
    "bag_info",
    "open_bag",
    "read_messages",
    "read_raw",
    "recover",
    "sample",
]
