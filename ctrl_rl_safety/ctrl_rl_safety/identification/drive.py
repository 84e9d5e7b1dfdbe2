"""Commands and odometry of a bag at common times."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ctrl_rl_bags.alignment import Tell, warn
from ctrl_rl_core.sensing import contradiction
from numpy.typing import NDArray

from ctrl_rl_bags import BagError, align, open_bag
from ctrl_rl_safety.errors import SafetyError

Array = NDArray[np.float64]

STEP = 0.01
"""Interval between rows [s]."""
LATEST = 0.5
"""Maximum odometry interval, and command age after which the robot may have stopped on its own [s]."""
_SHORTEST = 1.0
_EVERY = 5
"""Stride of the rows in the comparison of pose and twist."""
_TYPES = {
    "cmd_vel": ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"),
    "odom": ("nav_msgs/msg/Odometry",),
}


@dataclass(frozen=True)
class Drive:
    """A gapless segment of a drive, with one row per `STEP`.

    Attributes:
        commands: Latest commands, speed and turn rate (n, 2) [m/s, rad/s].
        poses: Odometry poses x, y, yaw (n, 3) [m, m, rad].
        speeds: Odometry speed and turn rate (n, 2) [m/s, rad/s].
    """

    commands: Array
    poses: Array
    speeds: Array


def read_drives(bag: Path, command_topic: str = "", odometry_topic: str = "", tell: Tell = warn) -> list[Drive]:
    """Return the segments of a bag with commands and with gapless, continuous odometry.

    Args:
        bag: Bag with commands and odometry.
        command_topic: Topic of Twist or TwistStamped; by default the only one ending in cmd_vel.
        odometry_topic: Topic of Odometry; by default the only one ending in odom.
        tell: Called with lines about omissions; a warning by default.

    Raises:
        SafetyError: A topic is missing or empty, or no segment lasts a second.
        BagError: The bag cannot be read.
    """
    with open_bag(bag) as opened:
        commands = _topic(opened.info.topics, command_topic, "cmd_vel", bag)
        odometry = _topic(opened.info.topics, odometry_topic, "odom", bag)
    try:
        # Log times of both: a delay lasts from sending a command to the odometry that shows its effect.
        found = align(
            bag, [commands, odometry], 1.0 / STEP, methods={odometry: "linear"}, clock="log", max_age=LATEST, tell=tell
        )
    except BagError as error:
        raise SafetyError(str(error)) from None
    drives = []
    for each in found:
        values, told = each.values[odometry], each.values[commands]
        whole = np.isfinite(values).all(axis=1) & np.isfinite(told).all(axis=1)
        if fault := contradiction(each.times[whole][::_EVERY], *np.split(values[whole][::_EVERY], [3], axis=1)):
            raise SafetyError(f"{bag}: {fault}")
        if whole.all() and len(each) * STEP >= _SHORTEST:
            drives.append(Drive(told, values[:, :3], values[:, 3:]))
    if not drives:
        raise SafetyError(f"{bag}: no second in which {commands} comes every {LATEST:g} s and {odometry} has no gap")
    return drives


def _topic(topics: object, given: str, ending: str, bag: Path) -> str:
    """Return the given topic, or else the only one of a name and type."""
    assert isinstance(topics, dict)
    kinds = _TYPES[ending]
    suited = [name for name, info in topics.items() if info.type in kinds and info.message_count > 0]
    if given:
        if given not in suited:
            raise SafetyError(f"{bag}: no messages of {' or '.join(kinds)} on {given}: there are {_words(suited)}")
        return given
    named = [name for name in suited if name.rsplit("/", 1)[-1] == ending]
    if len(named) != 1:
        what = "no topic" if not named else "several topics"
        option = "--commands" if ending == "cmd_vel" else "--odometry"
        raise SafetyError(f"{bag}: {what} named {ending} of {' or '.join(kinds)}: {option} one of {_words(suited)}")
    return named[0]


def _words(names: list[str]) -> str:
    return ", ".join(names) or "none"
