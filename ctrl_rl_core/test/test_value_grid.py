import itertools
import subprocess
import sys

import numpy as np
import pytest
from ctrl_rl_core.values.value_grid import Axis, GridError
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator
from value_grids import make_grid, quickly, random_axes

from ctrl_rl_core import ValueGrid

KERNELS = st.sampled_from([*((n, np.float64) for n in (1, 2, 3, 6)), (2, np.float32)])
"""Dimensions and type of the values; each pair takes seconds to compile without a cache."""


def mesh(axes) -> np.ndarray:
    return np.stack(np.meshgrid(*(axis.nodes for axis in axes), indexing="ij"), axis=-1)


def random_states(random: np.random.Generator, axes, count: int) -> np.ndarray:
    return random.uniform([a.lower for a in axes], [a.upper for a in axes], (count, len(axes)))


def peer(grid: ValueGrid) -> RegularGridInterpolator:
    """Return scipy's interpolator on the same grid; a periodic axis is closed with its first node."""
    values, nodes = np.asarray(grid.values, np.float64), []
    for k, axis in enumerate(grid.axes):
        nodes.append(np.append(axis.nodes, axis.upper) if axis.periodic else axis.nodes)
        if axis.periodic:
            values = np.concatenate([values, values.take([0], axis=k)], axis=k)
    return RegularGridInterpolator(nodes, values)


@pytest.mark.parametrize("n", range(1, 7))
def test_exact_on_multilinear_functions_and_their_gradients(n):
    @quickly
    @given(st.integers(0, 2**32))
    def check(seed):
        random = np.random.default_rng(seed)
        axes = random_axes(random, n)
        subsets = list(itertools.product([0, 1], repeat=n))
        coefficients = random.normal(size=len(subsets))

        def f(x):
            return sum(c * np.prod(x ** np.array(s), axis=-1) for c, s in zip(coefficients, subsets, strict=True))

        def slope(x, k):
            terms = zip(coefficients, subsets, strict=True)
            return sum(c * np.prod(np.delete(x ** np.array(s), k, axis=-1), axis=-1) for c, s in terms if s[k])

        grid = make_grid(f(mesh(axes)), axes)
        states = random_states(random, axes, 20)
        value, gradient = grid.value_and_gradient(states)
        scale = np.abs(grid.values).max()
        np.testing.assert_allclose(value, f(states), atol=1e-11 * scale)
        for k in range(n):
            np.testing.assert_allclose(gradient[:, k], slope(states, k), atol=1e-9 * scale)

    check()


@quickly
@given(st.integers(0, 2**32), KERNELS)
def test_agrees_with_scipy_also_across_the_seam_of_periodic_axes(seed, kernel):
    n, dtype = kernel
    random = np.random.default_rng(seed)
    axes = random_axes(random, n, periodic=True)
    grid = make_grid(random.normal(size=[axis.count for axis in axes]).astype(dtype), axes)
    states = random_states(random, axes, 50)
    np.testing.assert_allclose(grid.value(states), peer(grid)(states), atol=1e-12)


@quickly
@given(st.integers(0, 2**32), st.integers(-1000, 1000))
def test_periodic_axes_wrap_any_angle(seed, turns):
    random = np.random.default_rng(seed)
    axes = [Axis("x", "m", 0.0, 1.0, 3), Axis("theta", "rad", -np.pi, np.pi, 7, periodic=True)]
    grid = make_grid(random.normal(size=(3, 7)), axes)
    states = random_states(random, axes, 20)
    value, gradient = grid.value_and_gradient(states)
    value_turned, gradient_turned = grid.value_and_gradient(states + np.array([0, 2 * np.pi * turns]))
    np.testing.assert_allclose(value_turned, value, atol=1e-10)
    np.testing.assert_allclose(gradient_turned, gradient, atol=1e-9)


@quickly
@given(st.integers(0, 2**32), KERNELS)
def test_single_is_batch_and_gradient_brings_the_same_value(seed, kernel):
    n, dtype = kernel
    random = np.random.default_rng(seed)
    axes = random_axes(random, n, periodic=True)
    values = random.uniform(0, 9, [axis.count for axis in axes]).astype(dtype)
    values[random.random(values.shape) < 0.2] = np.inf
    grid = make_grid(values, axes, kind="time_to_reach")
    states = random_states(random, axes, 12) + random.choice([0.0, 0.0, 100.0], (12, n))
    value, gradient = grid.value_and_gradient(states)
    np.testing.assert_array_equal(grid.value(states), value)
    for row, state in enumerate(states):
        np.testing.assert_equal(grid.at(state), value[row])
        np.testing.assert_equal(float(grid.value(state)), value[row])
        one_value, one_gradient = grid.value_and_gradient_at(state)
        np.testing.assert_equal(one_value, value[row])
        np.testing.assert_array_equal(one_gradient, gradient[row])
        assert bool(grid.in_domain(state)) == (not np.isnan(value[row]))


@quickly
@given(st.integers(0, 2**32), st.integers(1, 4))
def test_gradient_is_the_derivative_of_the_value_next_to_unreachable_nodes(seed, n):
    random = np.random.default_rng(seed)
    axes = random_axes(random, n)
    values = random.uniform(0, 9, [axis.count for axis in axes])
    values[random.random(values.shape) < 0.25] = np.inf
    grid = make_grid(values, axes, kind="time_to_reach")
    states = random_states(random, axes, 50)
    value, gradient = grid.value_and_gradient(states)
    h = 1e-6
    for k, axis in enumerate(axes):
        step = h * np.eye(n)[k]
        above, below = grid.value(states + step), grid.value(states - step)
        within = (np.floor((states[:, k] + [[-h], [h]] - axis.lower) / axis.spacing)).astype(int)
        smooth = np.isfinite(above) & np.isfinite(below) & (within[0] == within[1])
        np.testing.assert_allclose(gradient[smooth, k], (above[smooth] - below[smooth]) / (2 * h), rtol=1e-4, atol=1e-3)
    assert np.isnan(gradient[~np.isfinite(value)]).all()
    assert np.isfinite(gradient[np.isfinite(value)]).all()


def test_the_edge_of_what_can_be_reached_lies_half_way_between_nodes():
    grid = make_grid([0.0, 1.0, np.inf], [Axis("x", "m", 0.0, 2.0, 3)], kind="time_to_reach")
    value, gradient = grid.value_and_gradient([[0.5], [1.0], [1.25], [1.5], [1.51], [2.0]])
    np.testing.assert_array_equal(value, [0.5, 1, 1, 1, np.inf, np.inf])
    np.testing.assert_array_equal(gradient.ravel(), [1, 0, 0, 0, np.nan, np.nan])
    assert grid.in_domain([[1.9]]).all()


def test_a_corridor_one_node_wide_stays_open():
    values = np.full((4, 3), np.inf)
    values[:, 1] = [0, 1, 2, 3]
    grid = make_grid(values, [Axis("x", "m", 0.0, 3.0, 4), Axis("y", "m", 0.0, 2.0, 3)], kind="time_to_reach")
    value, gradient = grid.value_and_gradient([[0.5, 1.0], [1.5, 0.7], [2.5, 1.4], [1.5, 0.4]])
    np.testing.assert_allclose(value, [0.5, 1.5, 2.5, np.inf])
    np.testing.assert_allclose(gradient[:3], [[1, 0]] * 3, atol=1e-12)


def test_exact_at_every_node_with_unreachable_neighbours():
    random = np.random.default_rng(0)
    axes = [Axis("x", "m", 0.0, 4.0, 5), Axis("theta", "rad", 0.0, 8.0, 8, periodic=True), Axis("y", "m", -1.0, 1.0, 3)]
    values = random.uniform(0, 5, (5, 8, 3))
    values[random.random(values.shape) < 0.3] = np.inf
    grid = make_grid(values, axes, kind="time_to_reach")
    np.testing.assert_array_equal(grid.value(mesh(axes)), values)


def test_outside_is_nan_and_the_edges_are_inside():
    axes = [Axis("x", "m", -0.3, 0.7, 11), Axis("theta", "rad", -np.pi, np.pi, 8, periodic=True)]
    grid = make_grid(np.ones((11, 8)), axes)
    inside = [[-0.3, 0], [0.7, 0], [0.7, np.pi], [0, 1e6], [0, -1e300], [0, -1e-300], [0, -np.pi]]
    beyond, before = np.nextafter(0.7, 1), np.nextafter(-0.3, -1)
    outside = [[beyond, 0], [before, 0], [np.nan, 0], [np.inf, 0], [-np.inf, 0], [0, np.nan], [0, np.inf], [0, -np.inf]]
    assert grid.in_domain(inside).all()
    np.testing.assert_allclose(grid.value(inside), 1)
    value, gradient = grid.value_and_gradient(outside)
    assert np.isnan(value).all()
    assert np.isnan(gradient).all()
    assert not grid.in_domain(outside).any()
    for state in np.array(outside):
        assert np.isnan(grid.at(state))
        assert np.isnan(grid.value_and_gradient_at(state)[1]).all()


def test_on_a_face_the_gradient_is_that_of_the_upper_cell_and_at_the_end_of_the_last():
    grid = make_grid([0.0, 1.0, 3.0], [Axis("x", "m", 0.0, 2.0, 3)])
    np.testing.assert_allclose(grid.value_and_gradient([[0.0], [1.0], [2.0]])[1].ravel(), [1, 2, 2])


def test_shapes_of_queries():
    grid = make_grid(np.zeros((2, 3)), [Axis("x", "m", 0.0, 1.0, 2), Axis("y", "m", 0.0, 1.0, 3)])
    value, gradient = grid.value_and_gradient(np.zeros((4, 5, 2)))
    assert value.shape == (4, 5)
    assert gradient.shape == (4, 5, 2)
    assert grid.value(np.zeros((0, 2))).shape == (0,)
    assert grid.value([0, 1]).shape == ()
    transposed = np.linspace(0, 1, 6).reshape(2, 3).T
    transposed.flags.writeable = False
    assert grid.value(transposed).shape == (3,)
    with pytest.raises(GridError, match=r"shape \(3,\); give \(..., 2\), one component per axis: x, y"):
        grid.value([0, 0, 0])
    with pytest.raises(GridError, match="not an array of numbers"):
        grid.value([["a", "b"]])
    with pytest.raises(GridError, match="as many components"):
        grid.at(np.zeros(3))


def test_values_are_a_private_copy():
    values = np.zeros(3)
    grid = make_grid(values, [Axis("x", "m", 0.0, 1.0, 3)])
    values[:] = 7
    assert grid.at(np.zeros(1)) == 0
    with pytest.raises(ValueError, match="read-only"):
        grid.values[0] = 1


def test_bad_axes_are_refused():
    with pytest.raises(GridError, match="give one to 6"):
        make_grid(np.zeros((2,) * 7), [Axis(f"x{k}", "m", 0.0, 1.0, 2) for k in range(7)])
    with pytest.raises(GridError, match="has 1 nodes"):
        Axis("x", "m", 0.0, 1.0, 1)
    with pytest.raises(GridError, match="no name"):
        Axis("", "m", 0.0, 1.0, 2)


def test_nodes():
    np.testing.assert_allclose(Axis("x", "m", 0.0, 1.0, 5).nodes, [0, 0.25, 0.5, 0.75, 1])
    axis = Axis("theta", "rad", 0.0, 1.0, 4, periodic=True)
    np.testing.assert_allclose(axis.nodes, [0, 0.25, 0.5, 0.75])
    assert axis.spacing == 0.25


def test_works_without_a_writable_cache_folder(tmp_path):
    """A read-only installation without a home folder compiles in memory instead of failing at import."""
    code = (
        "import numba.core.caching as caching\n"
        "caching.CacheImpl._locator_classes = []\n"
        "import numpy as np\n"
        "from ctrl_rl_core.values.value_grid import Axis, ValueGrid\n"
        "grid = ValueGrid(np.array([0.0, 1.0]), (Axis('x', 'm', 0.0, 1.0, 2),), 'oc_value', 't', 'a' * 64, 's', 0.0)\n"
        "assert grid.at(np.array([0.25])) == 0.25\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)
