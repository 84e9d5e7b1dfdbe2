"""InfoNCE against closed forms, and augmentations within their bounds."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from koopman_lqr_controller.training.networks.encoder_losses import info_nce, noisy, random_crop
from koopman_lqr_controller.training.networks.networks import centre_crop


@given(st.integers(2, 40))
def test_keys_that_are_all_alike_leave_a_guess(count: int) -> None:
    z = torch.ones(count, 3)
    assert info_nce(z, z, torch.eye(3)).item() == pytest.approx(math.log(count), abs=1e-5)


@given(st.floats(0.0, 5.0), st.integers(2, 8))
def test_orthogonal_keys_have_a_closed_form(scale: float, count: int) -> None:
    z = torch.eye(count)
    expected = math.log(math.exp(scale) + count - 1) - scale
    assert info_nce(z, z, scale * torch.eye(count)).item() == pytest.approx(expected, abs=1e-5)


def test_the_similarity_is_bilinear_and_row_i_belongs_to_key_i() -> None:
    queries, keys = torch.tensor([[1.0, 0.0], [0.0, 2.0]]), torch.tensor([[3.0, 1.0], [1.0, 1.0]])
    W = torch.tensor([[0.0, 1.0], [0.5, 0.0]])
    # z_q^T W z_k: [[1, 1], [3, 1]]
    expected = 0.5 * (math.log(2.0) + math.log(1.0 + math.exp(2.0)))
    assert info_nce(queries, keys, W).item() == pytest.approx(expected, abs=1e-6)


def test_large_similarities_do_not_overflow() -> None:
    z = 1e3 * torch.eye(4)
    assert info_nce(z, z, torch.eye(4)).item() == pytest.approx(0.0)


@given(st.floats(0.0, 1.0), st.integers(0, 100))
def test_noise_stays_within_its_share_of_each_component(eta: float, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    x = torch.randn(20, 5, generator=generator)
    moved = (noisy(x, eta, generator) - x).abs()
    assert (moved <= eta * x.abs() + 1e-6).all()
    assert eta < 0.01 or moved.max() > 0.5 * eta * x.abs().min()


def test_a_random_crop_is_a_window_of_its_own_image() -> None:
    images = torch.arange(4 * 2 * 9 * 9).reshape(4, 2, 9, 9).float()
    generator = torch.Generator().manual_seed(0)
    corners = set()
    for _ in range(30):
        windows = random_crop(images, 6, generator)
        assert windows.shape == (4, 2, 6, 6)
        for image, window in zip(images, windows, strict=True):
            corner = int(window[0, 0, 0] - image[0, 0, 0])
            top, left = divmod(corner, 9)
            assert torch.equal(window, image[:, top : top + 6, left : left + 6])
            corners.add((top, left))
    assert {top for top, _ in corners} == {left for _, left in corners} == {0, 1, 2, 3}


def test_a_centre_crop_is_the_middle() -> None:
    image = torch.arange(25).reshape(1, 5, 5)
    assert torch.equal(centre_crop(image, 3), image[:, 1:4, 1:4])
    assert torch.equal(centre_crop(image, 5), image)
