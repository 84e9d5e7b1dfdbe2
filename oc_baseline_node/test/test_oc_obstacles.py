"""Superellipses that cover obstacles."""

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oc_baseline_node.mpc.obstacles import covering_superellipse, covering_superellipses

from ctrl_rl_core import Box, Disc

lengths = st.floats(0.05, 5.0)


def near(shape: Box | Disc, clearance: float) -> np.ndarray:
    """Return points on the boundary of the shape inflated by the clearance, and inside it."""
    reach = 8.0
    random = np.random.default_rng(0)
    points = np.asarray(shape.centre) + random.uniform(-reach, reach, (4000, 2))
    return points[shape.signed_distance(points) <= clearance]


@settings(max_examples=40, deadline=None)
@given(lengths, lengths, st.floats(0.0, 1.0), st.floats(-3.0, 3.0), st.sampled_from([4, 6, 8]))
def test_every_point_within_the_clearance_of_a_box_is_inside(
    width: float, height: float, clearance: float, angle: float, exponent: int
) -> None:
    box = Box((1.0, -2.0), (width, height), angle)
    points = near(box, clearance)
    # The rounded corner itself, where a superellipse is nearest to cutting in.
    turn = np.linspace(0.0, np.pi / 2, 200)
    corner = 0.5 * np.array([width, height]) + clearance * np.column_stack((np.cos(turn), np.sin(turn)))
    c, s = np.cos(angle), np.sin(angle)
    corner = np.asarray(box.centre) + corner @ np.array([[c, s], [-s, c]])
    assert np.allclose(box.signed_distance(corner), clearance, atol=1e-9)
    for some in (points, corner):
        assert (covering_superellipse(box, clearance, exponent).outside(*some.T) <= 1e-9).all()


@settings(max_examples=60, deadline=None)
@given(st.floats(0.05, 1.0), st.floats(1.0, 40.0), st.floats(0.1, 0.5), st.floats(-3.0, 3.0), st.booleans())
def test_a_long_box_is_covered_and_its_ends_stay_open(
    thickness: float, ratio: float, clearance: float, angle: float, upright: bool
) -> None:
    size = (min(ratio * thickness, 12.0), thickness)
    box = Box((1.0, -2.0), size[::-1] if upright else size, angle)
    ellipses = covering_superellipses(box, clearance)
    random = np.random.default_rng(0)
    local = random.uniform(-1.0, 1.0, (4000, 2)) * (0.5 * np.array(box.size) + clearance)
    turn = np.linspace(0.0, 2.0 * np.pi, 400)
    edge = np.column_stack((np.cos(turn), np.sin(turn)))
    local = np.vstack((local, 0.5 * np.array(box.size) * np.sign(edge) + clearance * edge))
    c, s = np.cos(angle), np.sin(angle)
    points = np.asarray(box.centre) + local @ np.array([[c, s], [-s, c]])
    points = points[box.signed_distance(points) <= clearance + 1e-9]
    assert (np.min([ellipse.outside(*points.T) for ellipse in ellipses], axis=0) <= 1e-6).all()
    end = 0.5 * max(box.size) + clearance + 0.15
    tip = np.asarray(box.centre) + np.array([[0.0, end] if upright else [end, 0.0]]) @ np.array([[c, s], [-s, c]])
    assert all((ellipse.outside(*tip.T) > 0.0).all() for ellipse in ellipses)


def test_the_boxes_of_the_shipped_tasks_have_one_cover_each() -> None:
    assert len(covering_superellipses(Box((0.0, 0.0), (0.7, 0.7)), 0.277)) == 1
    assert len(covering_superellipses(Box((0.0, 0.0), (3.0, 1.5)), 0.44)) == 1
    assert len(covering_superellipses(Box((0.0, 0.0), (8.0, 0.3)), 0.277)) == 3


def test_a_disc_is_covered_exactly() -> None:
    ellipse = covering_superellipse(Disc((1.0, 2.0), 0.5), 0.25)
    points = np.random.default_rng(0).uniform(-2.0, 4.0, (1000, 2))
    distance = np.linalg.norm(points - (1.0, 2.0), axis=1) - 0.75
    assert ellipse.outside(*points.T) == pytest.approx(distance, abs=1e-8)


def test_a_cover_wastes_little_of_the_room() -> None:
    """For the cubes of car_navigation, a superellipse wastes centimetres of free space, a disc decimetres."""
    box, clearance = Box((0.0, 0.0), (0.7, 0.7)), 0.277
    ellipse = covering_superellipse(box, clearance)
    assert ellipse.semi_axes[0] < 0.5 * 0.7 + clearance + 0.01
    assert np.hypot(0.35, 0.35) + clearance > ellipse.semi_axes[0] + 0.1


def test_casadi_and_numpy_agree_and_the_middle_has_a_finite_gradient() -> None:
    ellipse = covering_superellipse(Box((0.5, -0.5), (1.0, 2.0), 0.3), 0.2)
    x, y = casadi.SX.sym("x"), casadi.SX.sym("y")
    value = ellipse.outside(x, y)
    f = casadi.Function("f", [x, y], [value, casadi.gradient(value, casadi.vertcat(x, y))])
    for point in ((0.0, 0.0), (0.5, -0.5), (3.0, 1.0)):
        ours, gradient = f(*point)
        assert float(ours) == pytest.approx(ellipse.outside(*point))
        assert np.isfinite(np.asarray(gradient)).all()
