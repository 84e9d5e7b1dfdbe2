"""Scalars as distributions over bins."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from koopman_lqr_controller.training.networks.two_hot import cross_entropy, symmetric_bins, two_hot

BINS = symmetric_bins(3.0, 13)
LARGEST = np.expm1(3.0)


def test_bins_are_symmetric_and_denser_around_nothing() -> None:
    assert BINS.numpy() == pytest.approx(-BINS.numpy()[::-1])
    assert (float(BINS[0]), float(BINS[6])) == (pytest.approx(-LARGEST), 0.0)
    assert float(BINS[7]) == pytest.approx(np.expm1(0.5))


@given(st.lists(st.floats(-50.0, 50.0, width=32), min_size=1, max_size=20))
def test_the_mean_of_a_distribution_is_its_number(numbers: list[float]) -> None:
    shares = two_hot(torch.tensor(numbers), BINS)
    assert (shares @ BINS).numpy() == pytest.approx(np.clip(numbers, -LARGEST, LARGEST), abs=1e-4)
    assert shares.sum(dim=1).numpy() == pytest.approx(1.0)
    assert shares.min() >= 0.0
    for row in shares:
        found = row.nonzero()[:, 0]
        assert len(found) <= 2
        assert int(found[-1] - found[0]) <= 1, "neighbours"


def test_the_cross_entropy_is_that_of_the_distribution() -> None:
    generator = torch.Generator().manual_seed(0)
    logits, numbers = torch.randn(4, 3, 13, generator=generator), 5.0 * torch.randn(4, 3, generator=generator)
    expected = torch.nn.functional.cross_entropy(
        logits.reshape(12, 13), two_hot(numbers.reshape(12), BINS), reduction="none"
    )
    torch.testing.assert_close(cross_entropy(logits, numbers, BINS), expected.reshape(4, 3))
