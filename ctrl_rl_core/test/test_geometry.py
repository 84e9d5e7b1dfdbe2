"""Boxes, discs and corridors compared with hand-computed or brute-force geometry."""

import numpy as np
import pytest
from ctrl_rl_core.geometry.shapes import Opening, frame_walls
from hypothesis import given
from hypothesis import strategies as st

from ctrl_rl_core import Arc, ArcPath, Box, Disc, signed_distance

WIDTH = 0.7
PATH = ArcPath((Arc(1.0, 0.0), Arc(1.5, 1.0), Arc(0.4, 0.0), Arc(2.0, -1 / 0.9), Arc(1.0, 0.0)), (0.3, -0.2), 0.4)
coordinates = st.floats(-3.0, 3.0)


@given(coordinates, coordinates, st.floats(-np.pi, np.pi))
def test_a_box_is_as_far_as_its_nearest_boundary_point(x: float, y: float, angle: float) -> None:
    box = Box((0.5, -0.25), (2.0, 1.0), angle)
    t = np.linspace(-1.0, 1.0, 2001)
    edges = np.concatenate([np.column_stack((t, np.full_like(t, 0.5 * s))) for s in (-1, 1)])
    edges = np.concatenate((edges, *[np.column_stack((np.full_like(t, 1.0 * s), 0.5 * t)) for s in (-1, 1)]))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    nearest = np.linalg.norm(edges @ turn.T + box.centre - (x, y), axis=1).min()
    local = turn.T @ (np.array([x, y]) - box.centre)
    inside = abs(local[0]) < 1.0 and abs(local[1]) < 0.5
    assert box.signed_distance((x, y)) == pytest.approx(-nearest if inside else nearest, abs=2e-3)


def test_the_nearest_shape_counts_and_nothing_is_infinitely_far() -> None:
    shapes = (Disc((0.0, 0.0), 1.0), Box((5.0, 0.0), (2.0, 2.0)))
    assert signed_distance(shapes, [[2.0, 0.0], [3.9, 0.0], [0.0, 0.0]]) == pytest.approx([1.0, 0.1, -1.0])
    assert np.isinf(signed_distance((), [0.0, 0.0]))


def test_frame_walls_leave_the_inside_free_and_have_no_gap() -> None:
    walls = frame_walls((-1.0, 2.0), (0.0, 1.0), 0.2)
    inside = np.random.default_rng(0).uniform((-1.0, 0.0), (2.0, 1.0), (500, 2))
    margin = np.minimum.reduce((inside[:, 0] + 1, 2 - inside[:, 0], inside[:, 1], 1 - inside[:, 1]))
    assert signed_distance(walls, inside) == pytest.approx(margin)
    corners = [[-1.1, -0.1], [2.1, -0.1], [-1.1, 1.1], [2.1, 1.1]]
    assert (signed_distance(walls, corners) <= 0.0).all()


def test_a_path_is_continuous_in_place_and_direction() -> None:
    s = np.linspace(0.0, PATH.length, 5000)
    pose = PATH.pose(s)
    step = np.linalg.norm(np.diff(pose[:, :2], axis=0), axis=1)
    assert step == pytest.approx(np.diff(s), rel=1e-4)
    assert np.abs(np.diff(pose[:, 2])).max() < 1.2 * (s[1] - s[0])
    assert pose[0] == pytest.approx([0.3, -0.2, 0.4])


def test_a_quarter_circle_ends_where_it_must() -> None:
    assert ArcPath((Arc(np.pi, 0.5),)).pose(np.pi) == pytest.approx([2.0, 2.0, np.pi / 2])
    assert ArcPath((Arc(1.0, 0.0),)).pose([-1.0, 2.0]) == pytest.approx(np.array([[-1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))


def test_an_opening_takes_away_one_side_alone() -> None:
    low, high = 0.8, 1.4  # across the end of the first segment
    walls = PATH.walls(WIDTH, openings=(Opening(low, high, -1.0),))
    s = np.linspace(0.05, PATH.length - 0.05, 400)
    x, y, heading = PATH.pose(s).T
    for side, free in ((1.0, np.zeros(len(s), np.bool_)), (-1.0, (s > low) & (s < high))):
        offset = side * (0.5 * WIDTH + 0.02)
        inside = (
            signed_distance(walls, np.stack((x - offset * np.sin(heading), y + offset * np.cos(heading)), -1)) < 0.0
        )
        rim = (np.abs(s - low) < 0.03) | (np.abs(s - high) < 0.03)
        assert (inside == ~free)[~rim].all()


def test_an_opening_that_lies_beside_the_path_or_covers_it_all_is_borne() -> None:
    assert len(PATH.walls(WIDTH, openings=(Opening(-2.0, -1.0, 1.0),))) == len(PATH.walls(WIDTH))
    assert 2 * len(PATH.walls(WIDTH, openings=(Opening(-1.0, 99.0, 1.0),))) == len(PATH.walls(WIDTH))


def test_walls_stand_at_half_the_width_all_along() -> None:
    walls = PATH.walls(WIDTH, largest_sag=0.002)
    s = np.linspace(0.05, PATH.length - 0.05, 400)
    pose = PATH.pose(s)
    assert signed_distance(walls, pose[:, :2]) == pytest.approx(WIDTH / 2, abs=2.5e-3)


def test_walls_have_no_gap_that_a_beam_could_pass() -> None:
    walls = PATH.walls(WIDTH)
    s = np.linspace(0.01, PATH.length - 0.01, 4000)
    x, y, heading = PATH.pose(s).T
    for side in (-1.0, 1.0):
        offset = side * (WIDTH / 2 + 0.02)
        points = np.column_stack((x - offset * np.sin(heading), y + offset * np.cos(heading)))
        assert (signed_distance(walls, points) < 0.0).all()


def test_a_turn_tighter_than_half_the_width_is_refused() -> None:
    with pytest.raises(ValueError, match="too tight"):
        ArcPath((Arc(1.0, 1 / 0.3),)).walls(WIDTH)


@given(st.integers(0, 2**32))
def test_many_shapes_at_once_are_the_nearest_of_each(seed: int) -> None:
    random = np.random.default_rng(seed)
    boxes = [
        Box(tuple(random.uniform(-3, 3, 2)), tuple(random.uniform(0.1, 2, 2)), random.uniform(-3, 3)) for _ in range(3)
    ]
    discs = [Disc(tuple(random.uniform(-3, 3, 2)), random.uniform(0.1, 1)) for _ in range(2)]
    points = random.uniform(-5, 5, (4, 7, 2))
    shapes = [*boxes, *discs][: random.integers(1, 6)]
    expected = np.min([shape.signed_distance(points) for shape in shapes], axis=0)
    np.testing.assert_allclose(signed_distance(shapes, points), expected, atol=1e-12)
    np.testing.assert_allclose(signed_distance(shapes, points[0, 0]), expected[0, 0], atol=1e-12)
