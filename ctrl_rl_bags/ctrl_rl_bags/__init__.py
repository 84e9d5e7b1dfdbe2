"""Bags: what a run leaves behind and what is trained on again.

The public names of the modules `bag_writer`, `bag_reader`, `bag_recovery` and `alignment`.
"""

from ctrl_rl_bags.alignment.alignment import AlignedSamples, Extractor, Scan, TimeSeries, align, resample
from ctrl_rl_bags.format.checks import BagError
from ctrl_rl_bags.format.metadata import Qos, Topic
from ctrl_rl_bags.format.reader import (
    BagInfo,
    BagMessage,
    RawMessage,
    TopicInfo,
    bag_info,
    open_bag,
    read_messages,
    read_raw,
)
from ctrl_rl_bags.format.recovery import Recovery, recover
from ctrl_rl_bags.format.writer import BagWriter

__all__ = [
    "AlignedSamples",
    "BagError",
    "BagInfo",
    "BagMessage",
    "BagWriter",
    "Extractor",
    "Qos",
    "RawMessage",
    "Recovery",
    "Scan",
    "TimeSeries",
    "Topic",
    "TopicInfo",
    "align",
    "bag_info",
    "open_bag",
    "read_messages",
    "read_raw",
    "recover",
    "resample",
]
