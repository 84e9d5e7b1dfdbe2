"""Shortest paths to a box of poses: they end in it, and are never longer than to any lattice pose in it."""

import math

import numpy as np
import pytest
from ctrl_rl_core.values import cached_njit
from hypothesis import given, settings
from hypothesis import strategies as st
from ttr_reward_node.verification.dubins import to_box
from ttr_reward_node.verification.dubins_words import end_of, word

BOX = np.array([[3.7, 4.3], [3.7, 4.3], [0.45, 1.05]])
TOLERANCE = 1e-6


@cached_njit
def distance(x0: float, y0: float, a0: float, x1: float, y1: float, a1: float) -> tuple[float, int]:
    """Return the length of the shortest path between two poses, and its word."""
    c, s = math.cos(a0), math.sin(a0)
    dx, dy = x1 - x0, y1 - y0
    x, y = c * dx + s * dy, -s * dx + c * dy
    best, kind = math.inf, -1
    for k in range(6):
        t, p, q = word(k, x, y, a1 - a0)
        if t + p + q < best:
            best, kind = t + p + q, k
    return best, kind


@cached_njit
def nearest(states, box, lattice):
    """Return lengths (N,) from states (N, 3) to the nearest of lattice^3 poses in the box."""
    out, size = np.full(len(states), np.inf), box[:, 1] - box[:, 0]
    for n in range(len(states)):
        x, y, a = states[n]
        for i in range(lattice):
            for j in range(lattice):
                for k in range(lattice):
                    end = box[:, 0] + size * np.array([i, j, k]) / (lattice - 1)
                    out[n] = min(out[n], distance(x, y, a, end[0], end[1], end[2])[0])
    return out


def states_about(box, count, seed, far):
    random = np.random.default_rng(seed)
    low, high = box[:2, 0] - far, box[:2, 1] + far
    return random.uniform([*low, -np.pi], [*high, np.pi], (count, 3))


def check(states, box, lattice=11):
    lengths, paths = to_box(states, box)
    assert (lengths <= nearest(states, box, lattice) + TOLERANCE).all()
    for state, length, (kind, t, p, q) in zip(states, lengths, paths, strict=True):
        assert t + p + q == pytest.approx(length)
        x, y, a = end_of(int(kind), t, p, q, *state, length)
        assert box[0, 0] - 1e-6 <= x <= box[0, 1] + 1e-6
        assert box[1, 0] - 1e-6 <= y <= box[1, 1] + 1e-6
        assert (a - box[2, 0] + 1e-6) % (2.0 * np.pi) <= box[2, 1] - box[2, 0] + 2e-6


def test_a_turn_to_the_nearest_heading_is_found():
    """Poses reached by a single turn are a narrow ridge among poses that need an additional full turn."""
    lengths, _ = to_box(np.array([[3.082, 4.137, -0.866]]), BOX)
    assert lengths[0] == pytest.approx(0.866 + 0.45, abs=1e-6)


def test_paths_that_end_at_an_edge_are_found():
    """A search over a word's own parameters alone misses them by 0.3 mm."""
    box = np.array([[-0.5, 0.5], [-0.5, 0.5], [-0.15455, 0.26455]])
    check(states_about(box, 20, 0, 1.0), box, lattice=9)


@pytest.mark.parametrize("far", [0.5, 2.0, 8.0])
def test_no_pose_of_the_box_is_nearer(far):
    check(states_about(BOX, 200, 0, far), BOX)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    size=st.tuples(st.floats(0.05, 2.0), st.floats(0.05, 2.0), st.floats(0.05, 3.0)),
    heading=st.floats(-np.pi, np.pi),
    far=st.floats(0.1, 5.0),
    seed=st.integers(0, 10_000),
)
def test_no_pose_of_any_box_is_nearer(size, heading, far, seed):
    box = np.array([[-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5]]) * np.array(size)[:, None]
    box[2] += heading
    check(states_about(box, 20, seed, far), box, lattice=9)
