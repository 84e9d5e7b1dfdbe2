"""A path as a corridor in the scan, the robot's place on it, and what stops the robot."""

import math

import numpy as np
import pytest
from ctrl_rl_core.driving import PathDriver, PathView
from hypothesis import given
from hypothesis import strategies as st

from ctrl_rl_core import CtrlRlError, FunctionDriver, ScanGeometry, Sensors

LIDAR = ScanGeometry(360, 0.0, 2.0 * math.pi / 360, 0.1, 3.5)
NOTHING = np.full(360, np.inf, np.float32)
EIGHT = np.array(((0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, -2.0)))
"""Crosses itself at (2, 0)."""


def sensors(pose: tuple[float, float, float] | None, ranges: np.ndarray = NOTHING) -> Sensors:
    there = None if pose is None else np.array(pose)
    return Sensors(ranges, LIDAR, np.zeros(13), there, None, np.zeros(2))


def test_walls_stand_beside_a_straight_path() -> None:
    view = PathView(np.array(((0.0, 0.0), (10.0, 0.0))), 0.5)
    pose = np.array((3.0, 0.1, 0.0))
    view.update(pose)
    walls = view.corridor(NOTHING, LIDAR, pose, 0.0)
    assert walls[90] == pytest.approx(0.4, abs=0.01)
    assert walls[270] == pytest.approx(0.6, abs=0.01)
    assert walls[45] == pytest.approx(0.4 * math.sqrt(2.0), abs=0.02)
    assert np.isinf(walls[0])
    assert walls[180] < 2.1  # closed behind


def test_echoes_within_the_corridor_stay_and_those_beyond_are_hidden() -> None:
    view = PathView(np.array(((0.0, 0.0), (10.0, 0.0))), 0.5)
    pose, ranges = np.array((3.0, 0.0, 0.0)), NOTHING.copy()
    ranges[0], ranges[90], ranges[91], ranges[270] = 1.0, 0.3, np.nan, 2.0
    view.update(pose)
    seen = view.corridor(ranges, LIDAR, pose, 0.0)
    assert (seen[0], seen[90]) == (np.float32(1.0), np.float32(0.3))
    assert seen[270] == pytest.approx(0.5, abs=0.01)
    assert seen[91] == pytest.approx(0.5, abs=0.02)  # what was not measured is the wall


@given(st.floats(0.0, 1.0), st.floats(-0.3, 0.3), st.floats(-3.1, 3.1))
def test_beams_end_at_the_edge_of_the_corridor(share: float, aside: float, turn: float) -> None:
    view = PathView(EIGHT[:3], 0.5)
    corner = share > 4.0 / 6.0
    along = 6.0 * share
    place = (4.0 - aside, along - 4.0) if corner else (along, aside)
    pose = np.array((*place, turn))
    view.update(pose)
    walls = view.corridor(NOTHING, LIDAR, pose, 0.0)
    hit = walls < 0.8  # farther off it is closed behind
    assert hit.sum() > 20
    bearings = LIDAR.angle_increment * np.flatnonzero(hit) + turn
    ends = pose[:2] + walls[hit, None] * np.column_stack((np.cos(bearings), np.sin(bearings)))
    starts = np.array(((-1.5, 0.0), (4.0, 0.0)))
    stops = np.array(((4.0, 0.0), (4.0, 7.0)))
    ways = stops - starts
    t = np.clip(((ends[:, None] - starts) * ways).sum(2) / (ways**2).sum(1), 0.0, 1.0)
    away = np.linalg.norm(ends[:, None] - starts - t[..., None] * ways, axis=2).min(axis=1)
    assert away == pytest.approx(0.5, abs=0.01)


def test_a_path_that_crosses_itself_is_followed_in_order() -> None:
    view = PathView(EIGHT, 0.3)
    places = []
    for along in np.arange(0.0, 12.0, 0.05):
        lengths = np.array((0.0, 4.0, 6.0, 8.0, 12.0))
        view.update(np.array((*(np.interp(along, lengths, EIGHT[:, axis]) for axis in (0, 1)), 0.0)))
        places.append(view.place)
        assert view.place == pytest.approx(along, abs=0.06)
    assert view.left < 0.1


def test_it_turns_first_then_drives_and_stops_at_the_end() -> None:
    seen: list[Sensors] = []

    def decide(sensors: Sensors) -> np.ndarray:
        seen.append(sensors)
        return np.array((0.2, 0.1))

    driver = PathDriver(FunctionDriver(decide), EIGHT[:2], 0.4, 0.1, 1.0, 0.5)
    assert driver.command(sensors((0.0, 0.0, -3.0))).tolist() == [0.0, 1.0]
    assert driver.command(sensors((0.0, 0.0, -0.5)))[0] == 0.0  # until it nearly faces the path
    assert driver.command(sensors((0.0, 0.0, -0.1))).tolist() == [0.2, 0.1]
    assert driver.command(sensors((1.0, 0.0, -1.0)))[0] == 0.2
    assert seen[-1].goal is not None
    assert seen[-1].goal == pytest.approx((2.0, 0.0, 0.0), abs=0.06)
    with pytest.raises(CtrlRlError, match=r"1\.00 m from the path"):
        driver.command(sensors((1.0, 1.0, 0.0)))
    with pytest.raises(CtrlRlError, match="needs a pose"):
        driver.command(sensors(None))
    for x in np.arange(1.5, 3.9, 0.5):
        driver.command(sensors((x, 0.0, 0.0)))
    slow = driver.command(sensors((3.84, 0.0, 0.0)))
    assert slow == pytest.approx(np.array((0.2, 0.1)) * slow[0] / 0.2)
    assert not driver.arrived
    assert driver.command(sensors((3.95, 0.0, 0.0))).tolist() == [0.0, 0.0]
    assert driver.arrived
