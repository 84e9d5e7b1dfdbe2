"""Transforms of any kind: what is looked up is finite, and whoever contradicts another publisher is found."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from _attack import Attack
from ctrl_rl_core.navigation import TransformError, TransformTree
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

Random = np.random.Generator
_PERIOD_S = 0.05
_ODD_NAMES = ("", "/", "a\u202eb", "x" * 5000, "map", "base_link", "\x1b[31m", "odom/", "//odom")
_ODD_NUMBERS = (math.nan, math.inf, -math.inf, 1e308, -1e-320, 0.0)


def run(random: Random, _folder: Path) -> None:
    """Drive fifty robots, each with a fault of its transforms or none, and hostile ones in between."""
    for _ in range(50):
        _drive(random, str(random.choice(["none", "parents", "publishers"])))


def _drive(random: Random, fault: str) -> None:
    tree, begin = TransformTree(), float(random.uniform(0.0, 1e6))
    speed, rate, loud = random.uniform(0.0, 1.0), random.uniform(-2.0, 2.0), random.random() < 0.5
    away, rhythm = random.uniform(1.0, 5.0), int(random.integers(1, 4))
    found = ""
    for k in range(100):
        now = begin + k * _PERIOD_S
        stamp = round(1e9 * now)
        good = [_planar("map", "odom", 0.1, -0.2, 0.05, stamp)]
        good.append(_planar("odom", "base_link", speed * k * _PERIOD_S, 0.0, rate * k * _PERIOD_S, stamp))
        tree.update(TFMessage(transforms=good), now)
        tree.update(TFMessage(transforms=[_planar("base_link", "base_scan", -0.03, 0.0, 0.0, stamp)]), now, fixed=True)
        if fault == "parents" and k % rhythm == 0:
            tree.update(TFMessage(transforms=[_planar("map", "base_link", away, 0.0, 0.0, stamp)]), now)
        if fault == "publishers" and k % rhythm == 0:
            tree.update(TFMessage(transforms=[_planar("map", "odom", away, 0.0, 0.0, stamp + 1)]), now)
        if loud:
            said = tree.update(TFMessage(transforms=[_hostile(random, stamp)]), now)
            assert len(said) < 1000, f"a refusal of {len(said)} letters"
        try:
            pose = tree.lookup("map", "base_scan").pose
            found = found or tree.contradiction("map", "base_scan", now)
        except TransformError as error:
            words = str(error)
        else:
            words = ""
            assert np.isfinite(pose).all(), f"a pose of {pose}"
        assert words.isprintable(), repr(words)
        assert len(words) < 1000, f"an error of {len(words)} letters"
    if fault != "none":
        assert found, f"{fault}: nobody was told, {away:.2f} m apart, every {rhythm}. time"
        assert found.isprintable(), repr(found)
    elif not loud:
        assert not found, f"nothing was wrong, and it says: {found}"


def _planar(parent: str, child: str, x: float, y: float, yaw: float, stamp: int) -> TransformStamped:
    out = TransformStamped(child_frame_id=child)
    out.header.frame_id = parent
    out.header.stamp.sec, out.header.stamp.nanosec = divmod(stamp, 10**9)
    out.transform.translation.x, out.transform.translation.y = float(x), float(y)
    out.transform.rotation.z, out.transform.rotation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    return out


def _hostile(random: Random, stamp: int) -> TransformStamped:
    """Return a transform that is odd in its names, its numbers or its time, and not of the robot's own chain."""
    out = _planar(str(random.choice(_ODD_NAMES)), f"odd_{random.integers(50)}", *random.normal(size=3), stamp)
    if random.random() < 0.3:
        out.child_frame_id = str(random.choice(["", "/", "y" * 5000]))
    if random.random() < 0.5:
        place = [out.transform.translation, out.transform.rotation][int(random.integers(2))]
        setattr(place, str(random.choice(["x", "y", "z"])), float(random.choice(_ODD_NUMBERS)))
    if random.random() < 0.3:
        out.header.stamp.sec = int(random.choice([-(2**31), 0, 2**31 - 1]))
    return out


ATTACKS = [
    Attack(
        "transforms",
        "What is looked up is finite or refused in one line, and two publishers of one transform are found.",
        run,
    )
]
