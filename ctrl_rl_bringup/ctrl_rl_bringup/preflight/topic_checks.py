"""Checks of the graph and of time: publishers, subscribers, types, quality of service, rates and stamps."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from ctrl_rl_core.ros import LATCHED
from ctrl_rl_core.sensing import lidar_identity
from rclpy.duration import Duration
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible

from ctrl_rl_bringup.preflight.finding import Finding, Limits, no_go, note, ok
from ctrl_rl_bringup.preflight.recording import Endpoint, Recording, Times, Topic
from ctrl_rl_core import COMMAND, SENSOR

KINDS = {"scan": "sensor_msgs/msg/LaserScan", "odom": "nav_msgs/msg/Odometry"}
"""Types of the topics that every robot needs."""
ROBOT_COMMANDS = "cmd_vel"
"""Topic that the robot's base listens to."""
_ENDLESS_NS = 9 * 10**18
"""Durations from here on mean no limit [ns]."""
_PASSES_ON = ("watchdog", "twist_mux", "collision_monitor", "velocity_smoother")
"""Endings of the names of nodes that may publish the robot's cmd_vel, because they forward commands."""


def check_sensors(heard: Recording, _limits: Limits) -> Iterator[Finding]:
    """Find whether scan and odometry arrive."""
    for name, count in (("scan", len(heard.scans)), ("odom", len(heard.odometry))):
        topic, check = heard.topic(name), f"{name} topic"
        others = sorted({each.kind for each in topic.publishers} - {KINDS[name]})
        if others:
            yield no_go(
                check,
                f"{topic.name} is published as {', '.join(others)} by {_names(topic.publishers)}",
                f"it must be {KINDS[name]} only: remap the other topic",
            )
        elif not topic.publishers:
            domain = os.environ.get("ROS_DOMAIN_ID") or "0"
            yield no_go(
                check,
                f"nobody publishes {topic.name}",
                f"start the robot's bringup; robot and computer must be in one network and ROS domain (here {domain}); "
                f"where the topic has another name: --namespace, or --ros-args -r {name}:=NAME",
            )
        elif count == 0:
            yield no_go(
                check,
                f"{_names(topic.publishers)} publishes {topic.name}, but nothing arrives",
                "see whether the sensor runs (ros2 topic hz), and whether the network lets UDP through both ways",
            )
        else:
            yield ok(check, f"{count} messages on {topic.name} by {_names(topic.publishers)}")


def check_single_source(heard: Recording, _limits: Limits) -> Iterator[Finding]:
    """Find whether one lidar and one odometry source publish."""
    for name, what in (("scan", "lidar"), ("odom", "odometry source")):
        topic = heard.topic(name)
        identities = {lidar_identity(each.frame, each.geometry) for each in heard.scans} if name == "scan" else set()
        first = next(iter(identities), None)
        mixed = any(not each.matches(first) for each in identities) if first is not None else False
        if len(topic.publishers) > 1 or mixed:
            yield no_go(
                f"one {what}",
                f"{len(topic.publishers)} publishers of {topic.name}: {_names(topic.publishers)}"
                + (", and scans of different lidars" if mixed else ""),
                f"end all but one, or remap their {name}",
            )
        elif topic.publishers:
            yield ok(f"one {what}", f"only {_names(topic.publishers)} publishes {topic.name}")


def check_command_type(heard: Recording, _limits: Limits) -> Iterator[Finding]:
    """Find whether the robot subscribes to commands of the type that will be sent."""
    topic, check = heard.topic(heard.command_topic), "command type"
    ours = "geometry_msgs/msg/Twist" if heard.unstamped else "geometry_msgs/msg/TwistStamped"
    kinds = {each.kind for each in topic.subscribers}
    if not kinds:
        advice = "start the robot's bringup (and the watchdog, where commands go through it)"
        yield no_go(check, f"nobody listens to {topic.name}", advice)
    elif ours not in kinds:
        change = "without --unstamped" if heard.unstamped else "with --unstamped"
        setting = "true" if heard.unstamped else "false"
        yield no_go(
            check,
            f"{_names(topic.subscribers)} listens to {topic.name} as {', '.join(sorted(kinds))}, commands are {ours}",
            f"drive with enable_stamped_cmd_vel:={setting} (and run this {change}), or set the robot's own parameter",
        )
    elif len(kinds) > 1:
        yield note(check, f"{topic.name} has listeners of several types: {', '.join(sorted(kinds))}")
    else:
        yield ok(check, f"{_names(topic.subscribers)} listens to {topic.name} as {ours.rpartition('/')[2]}")


def check_qos(heard: Recording, _limits: Limits) -> Iterator[Finding]:
    """Find publishers and subscribers that cannot hear each other because of their quality of service."""
    found = False
    wanted = {"scan": SENSOR, "odom": SENSOR, "map": LATCHED, "/tf_static": LATCHED}
    for name, ours in wanted.items():
        for each in heard.topic(name).publishers:
            if reason := _incompatible(each.qos, ours):
                found = True
                wanted_profile = "reliable and transient local" if ours is LATCHED else "by the default profile"
                words = f"what {each.node} publishes on {heard.topic(name).name} is not heard: {reason}"
                yield no_go("QoS", words, f"let it publish {wanted_profile}")
    commands = heard.topic(heard.command_topic)
    for each in commands.subscribers:
        if reason := _incompatible(COMMAND, each.qos):
            found = True
            advice = "commands are sent reliable and volatile: let it subscribe with the default profile"
            yield no_go("QoS", f"{each.node} never hears commands on {commands.name}: {reason}", advice)
    for name in ("scan", "odom"):
        found |= bool(deaf := _deaf(heard.topic(name)))
        for line in deaf:
            yield note("QoS", line, "subscribe to sensors with best effort, volatile")
    if not found:
        yield ok("QoS", "all that publish and listen can hear each other")


def check_commanders(heard: Recording, _limits: Limits) -> Iterator[Finding]:
    """Find other nodes that drive the robot."""
    check, found = "only driver", False
    for name in dict.fromkeys((heard.command_topic, ROBOT_COMMANDS)):
        topic = heard.topic(name)
        through = name == ROBOT_COMMANDS != heard.command_topic
        rivals = [each for each in topic.publishers if not (through and each.node.endswith(_PASSES_ON))]
        if rivals:
            found = True
            advice = f"end it, or remap its {name}: the robot follows the latest command of any"
            if not through and all(each.node.endswith(_PASSES_ON) for each in rivals):
                advice = "drive through it: --commands cmd_vel_raw (or the topic that it listens to)"
            yield no_go(check, f"{_names(rivals)} publishes {topic.name}", advice)
    if not found:
        yield ok(check, f"nobody else publishes {heard.topic(heard.command_topic).name}")


def _deaf(topic: Topic) -> list[str]:
    """Return a line for each subscriber of a topic that cannot hear a publisher of it."""
    return [
        f"{listener.node} cannot hear {topic.name} of {speaker.node}: {reason}"
        for speaker in topic.publishers
        for listener in topic.subscribers
        if (reason := _incompatible(speaker.qos, listener.qos))
    ]


def _incompatible(publisher: QoSProfile, subscriber: QoSProfile) -> str:
    """Return why a subscriber does not hear a publisher, or empty."""
    compatibility, reason = qos_check_compatible(_comparable(publisher), _comparable(subscriber))
    return str(reason).strip().rstrip(";").replace("ERROR: ", "") if compatibility == QoSCompatibility.ERROR else ""


def _comparable(profile: QoSProfile) -> QoSProfile:
    """Unset a profile's endless durations, which the graph reports as set."""

    def limited(time: Duration) -> Duration:
        return time if 0 < time.nanoseconds < _ENDLESS_NS else Duration()

    return QoSProfile(
        depth=1,
        reliability=profile.reliability,
        durability=profile.durability,
        liveliness=profile.liveliness,
        deadline=limited(profile.deadline),
        liveliness_lease_duration=limited(profile.liveliness_lease_duration),
    )


def _names(endpoints: Sequence[Endpoint]) -> str:
    counts = Counter(each.node for each in endpoints)
    return ", ".join(node if count == 1 else f"{node} ({count} times)" for node, count in sorted(counts.items()))


_SLOW_CLOCK = "set the clocks of robot and computer by one server (chrony or systemd-timesyncd: timedatectl status)"


def check_rates(heard: Recording, limits: Limits) -> Iterator[Finding]:
    """Find slow, missing and bunched messages of scan and odometry."""
    for name, samples, least in (("scan", heard.scans, limits.scan_rate), ("odom", heard.odometry, limits.odom_rate)):
        if samples:
            yield rate_finding(f"{name} rate", [each.times for each in samples], heard, least, limits.largest_gap)


def rate_finding(check: str, times: Sequence[Times], heard: Recording, least: float, largest_gap: float) -> Finding:
    """Return the finding about one topic's rate.

    Args:
        check: Name of the check.
        times: Times of its messages, in order; at least one.
        heard: The recording, for its begin and end.
        least: Minimum rate [Hz].
        largest_gap: Maximum silence [s].
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
        return note(check, f"{words}; messages arrive in bursts", "the network or a busy computer delays them")
    return ok(check, words)


def check_stamps(heard: Recording, limits: Limits) -> Iterator[Finding]:
    """Find stale and future stamps, and stamps that do not rise."""
    for name, samples in (("scan", heard.scans), ("odom", heard.odometry)):
        if samples:
            yield stamp_finding(f"{name} stamps", [each.times for each in samples], heard.simulated, limits)


def stamp_finding(check: str, times: Sequence[Times], simulated: bool, limits: Limits) -> Finding:
    """Return the finding about one topic's stamps.

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
