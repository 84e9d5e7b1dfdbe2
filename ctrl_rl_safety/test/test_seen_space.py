"""Unseen space: determined from the scans, and avoided by a robot that must not drive into it."""

import math
from typing import Any

import numpy as np
import pytest
from ctrl_rl_safety.filter.seen_space import SeenSpace, sight_of

from ctrl_rl_core import ScanGeometry
from ctrl_rl_safety import ROBOTS, FilterOptions, Reading, SafetyFilter

MODEL = ROBOTS["turtlebot3_burger"]
HALF = ScanGeometry(181, -0.5 * math.pi, math.pi / 180, 0.1, 3.0)
"""A lidar that looks ahead only."""


def test_the_sight_of_a_scan_ends_at_echoes_at_the_largest_range_and_at_blind_beams() -> None:
    ranges = np.full(181, np.inf, np.float32)
    ranges[90], ranges[100], ranges[110] = 1.5, np.nan, 0.0
    ways = sight_of(ranges, HALF, 0.0).ways
    assert ways[0] == 1.5
    assert ways[10] == ways[20] == 0.0
    assert ways[30] == ways[330] == 3.0
    assert (ways[92:268] == 0.0).all()


def test_a_cell_stays_seen_when_the_robot_has_gone_on_and_what_it_never_saw_stays_unseen() -> None:
    space = SeenSpace(1.0, MODEL.radius)
    sight = sight_of(np.full(181, np.inf, np.float32), HALF, 0.0)

    def behind(x: float) -> float:
        """Return the distance behind a robot at x at which unseen space begins [m]."""
        edges = space.update(np.array((x, 0.0, 0.0)), sight)
        beside = edges[(np.abs(edges[:, 1]) < 0.1) & (edges[:, 0] < x)]
        return x - float(beside[:, 0].max(initial=-math.inf))

    assert 0.2 < behind(0.0) < 0.3
    assert 0.65 < behind(0.45) < 0.75
    assert behind(5.0) < 0.3  # none of it lies within reach any more


@pytest.mark.parametrize(("unseen", "went"), [("free", (0.5, 1.0)), ("obstacle", (0.0, 0.12))])
def test_a_robot_drives_backwards_into_the_unseen_only_where_it_may(unseen: Any, went: tuple[float, float]) -> None:
    sight = sight_of(np.full(181, np.inf, np.float32), HALF, 0.0)
    safety, x, v = SafetyFilter(MODEL, FilterOptions(unseen=unseen)), 0.0, 0.0
    for tick in range(60):
        reading = Reading(np.array((x, 0.0, 0.0)), v, 0.0)
        if tick % 4 == 0:
            safety.see(0.05 * tick, reading.pose, np.array(((2.0 - x, 0.0),)), sight=sight)
        verdict = safety.decide(0.05 * tick, reading, np.array((-MODEL.speed, 0.0)))
        safety.sent(0.05 * tick, verdict.command)
        v = float(verdict.command[0])
        x += 0.05 * v
    assert went[0] <= -x <= went[1]
