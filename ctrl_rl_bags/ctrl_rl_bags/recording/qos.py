"""Converts QoS between rclpy and bags, for recording, subscribing and publishing.

As in rosbag2, a request must match every publisher, and an offer every subscriber.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from ctrl_rl_bags.format.metadata import Qos


def to_bag_qos(profile: QoSProfile) -> Qos:
    """Convert an offered profile to a bag's form."""
    return {
        "history": profile.history.name.lower(),
        "depth": profile.depth,
        "reliability": profile.reliability.name.lower(),
        "durability": profile.durability.name.lower(),
        "deadline": _time(profile.deadline),
        "lifespan": _time(profile.lifespan),
        "liveliness": profile.liveliness.name.lower(),
        "liveliness_lease_duration": _time(profile.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": bool(profile.avoid_ros_namespace_conventions),
    }


def subscription_qos(offered: Sequence[QoSProfile], depth: int) -> QoSProfile:
    """Return the strongest request satisfied by all offers: reliable or latched only if all offers are."""
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered)
    latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in offered)
    return _profile(reliable, latched, depth)


def publisher_qos(recorded: Sequence[Qos], depth: int) -> QoSProfile:
    """Return a profile that matches every subscriber of the recorded ones; reliable if none was recorded."""
    reliable = not recorded or any(profile["reliability"] != "best_effort" for profile in recorded)
    return _profile(reliable, is_latched(recorded), depth)


def is_latched(recorded: Sequence[Qos]) -> bool:
    """Return whether late subscribers receive the last messages."""
    return any(profile["durability"] == "transient_local" for profile in recorded)


def _profile(reliable: bool, latched: bool, depth: int) -> QoSProfile:
    return QoSProfile(
        depth=depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _time(duration: Duration) -> dict[str, Any]:
    seconds, nanoseconds = divmod(duration.nanoseconds, 10**9)
    return {"sec": seconds, "nsec": nanoseconds}
