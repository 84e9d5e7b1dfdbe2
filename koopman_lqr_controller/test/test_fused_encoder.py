"""The fused encoder gives the same results as the original one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from koopman_lqr_controller.control.latent_controller import FusedEncoder
from koopman_lqr_controller.models.encoder import CentreCrop, Dense, Flatten, LayerNorm

from koopman_lqr_controller import Encoder, KoopmanError

KINDS = st.lists(st.sampled_from(["linear", "rectified", "norm"]), min_size=1, max_size=6)


@given(st.integers(0, 1000), KINDS, st.booleans())
def test_it_is_the_same_up_to_rounding(seed: int, kinds: list[str], reduced: bool) -> None:
    random = np.random.default_rng(seed)

    def some(*shape: int) -> np.ndarray:
        return random.normal(size=shape).astype(np.float32)

    layers = [
        LayerNorm(some(6), some(6)) if kind == "norm" else Dense(some(6, 6), some(6), kind == "rectified")
        for kind in ("linear", *kinds)
    ]
    encoder = Encoder(tuple(layers), (6,), some(6), np.exp(some(6)))
    projection = random.normal(size=(2, 6)) if reduced else None
    quick = FusedEncoder(encoder, projection)
    for x in some(5, 6):
        z = encoder(x) if projection is None else projection @ encoder(x)
        assert quick(x) == pytest.approx(z, rel=2e-3, abs=2e-3 * np.abs(z).max())
        assert quick(x).dtype == np.float64


def test_what_is_linear_together_is_one_matrix() -> None:
    """Three dense layers, a norm and a projection become one product before the norm and one after it."""
    one = np.ones(3, np.float32)
    dense = Dense(2.0 * np.eye(3, dtype=np.float32), 0 * one, False)
    encoder = Encoder((dense, dense, LayerNorm(2 * one, one), dense), (3,), one, 2 * one)
    quick = FusedEncoder(encoder, np.array([[1.0, 0.0, 0.0]]))
    assert [step.matrix.shape for step in quick._steps] == [(4, 4)]
    assert quick._steps[0].matrix[:3, :3] == pytest.approx(2.0 * (np.eye(3) - 1 / 3), abs=1e-6)
    assert quick._last[:, 0] == pytest.approx([4.0, 0.0, 0.0, 2.0])


@pytest.mark.parametrize(
    "encoder",
    [
        Encoder((CentreCrop(2), Flatten()), (1, 4, 4), np.zeros(1, np.float32), np.ones(1, np.float32)),
        Encoder((Flatten(),), (4,), np.zeros(1, np.float32), np.ones(1, np.float32)),
        Encoder((), (4,), np.zeros(1, np.float32), np.ones(1, np.float32), inclusive=True),
    ],
)
def test_another_kind_of_encoder_is_refused(encoder: Encoder) -> None:
    with pytest.raises(KoopmanError, match="can be fused"):
        FusedEncoder(encoder)
