"""The score of the BARN challenge: success times the share of the optimal time that was taken, within two bounds.

The challenge's scripts (run.py, report_test.py) have score = success * OT / clip(AT, k OT, 8 OT), with the optimal
time OT = path length / (2 m/s), the actual time AT, and k = 2: at best 0.5. The later report of the ROS 2 version has
k = 4: at best 0.25. Both are given here. In DynaBARN, which has no planned paths, the scripts take goal minus start as
the length, which is negative: each success then scores 0.125. Here the length is 20 m.
"""

from __future__ import annotations

FASTEST = 2.0
"""Speed of the optimal time [m/s]."""
LOW, LOW_ROS2, HIGH = 2.0, 4.0, 8.0


def score(succeeded: bool, seconds: float, length: float, low: float = LOW) -> float:
    """Return the score of one drive, 0 to 1 / low.

    Args:
        succeeded: Whether the goal was reached without a contact, in time.
        seconds: Time from the first motion to the end [s].
        length: Length of the optimal path [m].
        low: Multiple of the optimal time below which being faster earns nothing.
    """
    optimal = length / FASTEST
    return float(succeeded) * optimal / min(max(seconds, low * optimal), HIGH * optimal)
