"""Obstacles stay until beams pass through them, whoever walks by is gone at once, and nothing else is forgotten."""

import math

import numpy as np
import pytest
from ctrl_rl_navigation.driving.obstacle_layer import ObstacleLayer

from ctrl_rl_core import OccupancyMap

HALL = OccupancyMap(np.zeros((200, 200), np.int8), 0.05)
POSE = np.array((5.0, 5.0, 0.0))
MEMORY = 10.0
BEARINGS = np.radians(np.arange(360.0))
RING = np.column_stack((np.cos(BEARINGS), np.sin(BEARINGS)))
NOTHING = np.empty((0, 2))


@pytest.fixture
def layer() -> ObstacleLayer:
    return ObstacleLayer(HALL, np.full(HALL.cells.shape, 4.0, np.float32), MEMORY)


def look(layer: ObstacleLayer, now: float, ahead: float = math.inf, around: float = math.inf) -> None:
    """See something within 10 degrees straight ahead, and something all around [m]; inf for no echo."""
    ranges = np.full(360, around)
    ranges[np.r_[-10:11]] = min(ahead, around)
    echo = np.isfinite(ranges)
    layer.update(now, POSE, RING[echo] * ranges[echo, None], 8.0 * RING[~echo])


def test_what_stood_stays_while_nobody_looks(layer: ObstacleLayer) -> None:
    for now in np.arange(0.0, 2.0, 0.2):
        look(layer, now, 1.5)
    count = len(layer)
    assert count > 5
    layer.update(3600.0, POSE, NOTHING)
    assert len(layer) == count


def test_what_was_seen_briefly_is_dropped_after_the_memory(layer: ObstacleLayer) -> None:
    look(layer, 0.0, 1.5)
    layer.update(MEMORY - 0.1, POSE, NOTHING)
    assert len(layer) > 5
    layer.update(MEMORY + 0.1, POSE, NOTHING)
    assert len(layer) == 0


def test_an_echo_from_behind_clears_a_place_at_once(layer: ObstacleLayer) -> None:
    for now in np.arange(0.0, 2.0, 0.2):
        look(layer, now, 1.5)
    look(layer, 2.0, around=2.5)
    assert np.hypot(*(layer.points() - POSE[:2]).T).min() > 2.0


def test_scans_without_an_echo_clear_it_when_they_are_enough(layer: ObstacleLayer) -> None:
    for now in np.arange(0.0, 2.0, 0.2):
        look(layer, now, 1.5)
    for now in np.arange(2.0, 2.7, 0.2):
        look(layer, now)
    assert len(layer) > 5
    look(layer, 2.8)
    assert len(layer) == 0


def test_an_echo_that_comes_back_begins_the_count_anew(layer: ObstacleLayer) -> None:
    for now in np.arange(0.0, 8.0, 0.2):
        look(layer, now, 1.5 if round(now / 0.2) % 4 == 0 else math.inf)
    assert len(layer) > 5


@pytest.mark.parametrize("degrees", [0.5, 1.0, 2.0, 4.0])
def test_beams_however_far_apart_clear_it(layer: ObstacleLayer, degrees: float) -> None:
    bearings = np.radians(np.arange(0.0, 360.0, degrees))
    ring = np.column_stack((np.cos(bearings), np.sin(bearings)))
    near = np.abs(np.arctan2(ring[:, 1], ring[:, 0])) < 0.2
    layer.update(0.0, POSE, 1.5 * ring[near])
    assert len(layer)
    layer.update(0.2, POSE, 3.6 * ring)
    assert len(layer) == 0


def test_somebody_who_walks_by_leaves_nothing(layer: ObstacleLayer) -> None:
    """A disc of 0.4 m passes at 1.5 m and 1 m/s before a lidar with walls, and one without, within its range."""
    for behind in (3.4, math.inf):
        for now in np.arange(0.0, 6.0, 0.2):
            centre = np.array((1.5, now - 3.0))
            along = RING @ centre
            room = 0.2**2 - (centre @ centre - along**2)
            ranges = np.where((room > 0.0) & (along > 0.0), along - np.sqrt(np.maximum(room, 0.0)), behind)
            echo = np.isfinite(ranges)
            layer.update(now, POSE, RING[echo] * ranges[echo, None], 3.5 * RING[~echo])
        places = layer.points() - POSE[:2]
        assert not (np.hypot(*places.T) < 2.0).any() or np.abs(places[:, 1]).min() > 1.5, behind
        layer.clear()


def test_what_is_held_stays_whatever_scans_show_until_it_is_forgotten(layer: ObstacleLayer) -> None:
    wall = np.array((6.0, 5.0))
    layer.hold(np.array([wall]))
    look(layer, 0.0, around=2.5)
    assert (np.hypot(*(layer.points() - wall).T) < 0.05).any()
    assert layer.forget(0.0, 2.0)
    assert not (np.hypot(*(layer.points() - wall).T) < 0.05).any()
    assert len(layer) > 5
    assert not layer.forget(0.0, 2.0)
