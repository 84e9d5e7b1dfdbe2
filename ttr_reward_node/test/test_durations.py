"""Durations of steps as 16-bit codes: exact where they are few, else rounded."""

import numpy as np
import pytest
from ttr_reward_node.solvers.durations import DurationTable

UNIT = 0.7


def entered(durations: np.ndarray) -> np.ndarray:
    """Return the durations (slabs, pairs) that the table of some gives back."""
    table = DurationTable((len(durations), 1, 1, durations.shape[1]), UNIT)
    for begin in range(0, len(durations), 100):
        table.enter(slice(begin, begin + 100), 0, durations[begin : begin + 100].ravel())
    codes, book = table.codes()
    assert codes.dtype == np.uint16
    assert book[0] == 0.0
    return book[codes]


def test_few_durations_stay_exact():
    few = np.array([0.0, 0.1, 2.5, 1e-9, 1e9], np.float32)[np.arange(60).reshape(20, 3) % 5]
    np.testing.assert_array_equal(entered(few), few)


@pytest.mark.parametrize("slabs", [9_000, 40_000])
def test_many_are_rounded_without_bias(slabs):
    """Fewer and more than those that are kept until all are known."""
    many = np.exp(np.random.default_rng(0).uniform(np.log(1e-3 * UNIT), np.log(1e5 * UNIT), (slabs, 8)))
    off = entered(many) / many - 1.0
    assert np.abs(off).max() <= 1.0 / 4096 + 1e-6
    assert abs(off.mean()) < 2e-6


@pytest.mark.parametrize("slabs", [9_000, 40_000])
def test_beyond_the_range(slabs):
    """A step that is too short takes the shortest time, never none; one that takes for ever is no step."""
    many = np.random.default_rng(0).uniform(0.1, 1.0, (slabs, 8))
    many[:4, 0] = 0.0, 1e-12, 1e300, np.inf
    found = entered(many)[:4, 0]
    np.testing.assert_allclose(found, [0.0, UNIT / 4096, 0.0, 0.0])
