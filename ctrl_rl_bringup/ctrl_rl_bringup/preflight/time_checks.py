"""Checks of time: how often messages come, and whether their stamps fit this computer's clock."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ctrl_rl_bringup.preflight.finding import Finding, Limits, no_go, note, ok
from ctrl_rl_bringup.preflight.recording import Recording, Times

_SLOW_CLOCK = "set the clocks of robot and computer by one server (chrony or systemd-timesyncd: timedatectl status)"


def check_rates(heard: Recording, limits: Limits) -> Iterator[Finding]:
    """Find slow, missing and bunched messages of scan and odometry."""
    for name, samples, least in (("scan", heard.scans, limits.scan_rate), ("odom", heard.odometry, limits.odom_rate)):
        if samples:
            yield rate_finding(f"{name} rate", [each.times for each in samples], heard, least, limits.largest_gap)


def rate_finding(check: str, times: Sequence[Times], heard: Recording, least: float, largest_gap: float) -> Finding:
    """Return what is found on the rate of one topic.

    Args:
        check: Name of the check.
        times: Times of its messages, in order; at least one.
        heard: The recording, for its begin and end.
        least: Least rate [Hz].
        largest_gap: Longest silence [s].
    """
    arrivals = np.array([heard.begin, *(each.arrival for each in times), heard.end])
    gaps = np.diff(arrivals)
    rate = len(times) / max(heard.end - heard.begin, 1e-3)
    longest = float(gaps.max())
    words = f"{rate:.1f} Hz, longest gap {longest:.2f} s"
    if rate < least:
        return no_go(check, f"{words}: at least {least:g} Hz is needed", "see to the sensor, its cable and the network")
    if longest > largest_gap:
        advice = "see to the Wi-Fi (5 GHz, near the robot) and to the load of both computers (top)"
        return no_go(check, f"{words}: at most {largest_gap:g} s is allowed", advice)
    inner = gaps[1:-1]
    if len(inner) > 1 and float(inner.std()) > 0.75 * float(inner.mean()):
        return note(check, f"{words}; messages come in bunches", "the network or a busy computer holds them back")
    return ok(check, words)


def check_stamps(heard: Recording, limits: Limits) -> Iterator[Finding]:
    """Find stale and future stamps, and those that stand still or go back."""
    for name, samples in (("scan", heard.scans), ("odom", heard.odometry)):
        if samples:
            yield stamp_finding(f"{name} stamps", [each.times for each in samples], heard.simulated, limits)


def stamp_finding(check: str, times: Sequence[Times], simulated: bool, limits: Limits) -> Finding:
    """Return what is found on the stamps of one topic.

    Args:
        check: Name of the check.
        times: Times of its messages, in order; at least one.
        simulated: Whether a /clock gave the time.
        limits: Limits of the ages.
    """
    steps = np.diff([each.stamp for each in times])
    age = float(np.median([each.age for each in times]))
    clock = "/clock" if simulated else "this computer's clock"
    if (steps <= 0.0).any():
        count = int((steps <= 0.0).sum())
        advice = "its driver repeats messages, or two publish, or its clock was set back: start it again"
        return no_go(check, f"{count} of {len(steps)} stamps are not later than the one before", advice)
    if age > limits.largest_age:
        return no_go(check, f"{age:.2f} s behind {clock}: at most {limits.largest_age:g} s is allowed", _SLOW_CLOCK)
    if age < -limits.largest_lead:
        return no_go(check, f"{-age:.2f} s ahead of {clock}: at most {limits.largest_lead:g} s", _SLOW_CLOCK)
    return ok(check, f"{1000 * age:.0f} ms behind {clock}")
