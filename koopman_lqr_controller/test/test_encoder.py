"""The deployed encoder computes what the learnt one does, without torch."""

import json

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from koopman_lqr_controller.encoder import EPSILON, CentreCrop, Dense, Encoder, Flatten, LayerNorm
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.networks import TorchEncoder

ENCODERS = {
    "vector": {"shape": (7,), "depth": 2, "crop": None, "middle": 0.5, "unit": 2.0},
    "image": {"shape": (3, 24, 24), "depth": 3, "crop": 21, "middle": 127.5, "unit": 127.5},
}


def some_encoder(kind: str) -> tuple[TorchEncoder, np.ndarray]:
    torch.manual_seed(3)
    wanted = ENCODERS[kind]
    middle, unit = torch.tensor(wanted["middle"]), torch.tensor(wanted["unit"])
    encoder = TorchEncoder(wanted["shape"], 6, 16, wanted["depth"], middle, unit, wanted["crop"])
    torch.nn.init.normal_(encoder.layers[-1].weight)
    torch.nn.init.normal_(encoder.layers[-1].bias)
    random = np.random.default_rng(0)
    x = (
        random.integers(256, size=(5, *wanted["shape"]), dtype=np.uint8)
        if kind == "image"
        else random.normal(size=(5, 7))
    )
    return encoder, x


@pytest.mark.parametrize("kind", ENCODERS)
def test_numpy_agrees_with_torch(kind: str) -> None:
    encoder, x = some_encoder(kind)
    expected = encoder.eval()(torch.from_numpy(x).float()).detach().numpy()
    deployed = encoder.deploy()
    assert deployed(x) == pytest.approx(expected, abs=2e-5)
    assert deployed(x[0]) == pytest.approx(expected[0], abs=2e-5)
    assert deployed(x).dtype == np.float64


@pytest.mark.parametrize("kind", ENCODERS)
def test_a_description_gives_the_same_encoder_back(kind: str) -> None:
    encoder, x = some_encoder(kind)
    deployed = encoder.deploy()
    description, tensors = deployed.describe()
    again = Encoder.build(json.loads(json.dumps(description)), tensors)
    assert np.array_equal(again(x), deployed(x))


def test_another_shape_is_refused() -> None:
    deployed = some_encoder("vector")[0].deploy()
    with pytest.raises(KoopmanError, match=r"observation has shape \(6,\), the encoder wants \(7,\)"):
        deployed(np.zeros(6))


def test_an_unknown_layer_is_named() -> None:
    description, tensors = some_encoder("vector")[0].deploy().describe()
    description["layers"][1]["kind"] = "magic"
    with pytest.raises(KoopmanError, match="layer 1 is no dense"):
        Encoder.build(description, tensors)


def test_what_makes_it_quick_changes_no_bit() -> None:
    """One observation, by the plain formulas."""
    random = np.random.default_rng(2)
    weights = [random.normal(size=shape).astype(np.float32) for shape in ((64, 38), (50, 64))]
    scale, shift = (random.normal(size=50).astype(np.float32) for _ in range(2))
    layers = (
        Dense(weights[0], weights[0][:, 0], True),
        Dense(weights[1], weights[1][:, 0], False),
        LayerNorm(scale, shift),
    )
    encoder = Encoder(layers, (38,), np.full(38, 0.5, np.float32), np.full(38, 2.0, np.float32))
    for x in random.normal(size=(20, 38)):
        y = (x.astype(np.float32) - np.float32(0.5)) / np.float32(2.0)
        y = np.maximum(y @ weights[0].T + weights[0][:, 0], np.float32(0.0))
        y = y @ weights[1].T + weights[1][:, 0]
        centred = y - y.mean(keepdims=True)
        variance = np.einsum("i,i->", centred, centred) / np.float32(50)
        expected = centred / np.sqrt(variance + EPSILON) * scale + shift
        assert np.array_equal(encoder(x), expected.astype(np.float64))


def test_an_inclusive_encoder_begins_with_the_normalised_observation() -> None:
    layer = Dense(np.ones((2, 3), np.float32), np.zeros(2, np.float32), rectified=False)
    encoder = Encoder((layer,), (3,), np.float32(1.0) * np.ones((), np.float32), np.full((), 2.0, np.float32), True)
    x = np.array([[1.0, 3.0, 5.0], [1.0, 1.0, 1.0]])
    assert encoder(x).tolist() == [[0.0, 1.0, 2.0, 3.0, 3.0], [0.0, 0.0, 0.0, 0.0, 0.0]]
    description, tensors = encoder.describe()
    assert np.array_equal(Encoder.build(description, tensors)(x), encoder(x))


@given(st.integers(0, 1000), st.lists(st.sampled_from(["linear", "rectified", "norm"]), min_size=1, max_size=6))
def test_fused_is_the_same_in_fewer_steps(seed: int, kinds: list[str]) -> None:
    random = np.random.default_rng(seed)

    def some(*shape: int) -> np.ndarray:
        return random.normal(size=shape).astype(np.float32)

    layers: list = [Dense(some(6, 5), some(6), False)]
    for kind in kinds:
        norm = LayerNorm(some(6), some(6))
        layers.append(norm if kind == "norm" else Dense(some(6, 6), some(6), kind == "rectified"))
    encoder = Encoder(tuple(layers), (5,), some(5), np.exp(some(5)))
    fused, x = encoder.fused(), some(20, 5)
    assert fused(x) == pytest.approx(encoder(x), rel=1e-3, abs=1e-3 * np.abs(encoder(x)).max())
    assert fused(x[0]) == pytest.approx(fused(x)[0], rel=1e-4, abs=1e-4 * np.abs(fused(x)).max())
    assert not fused.middle.any()
    assert len(fused.layers) == len(layers)


def test_a_norm_between_dense_layers_loses_its_mean_scale_and_shift() -> None:
    one = np.ones(3, np.float32)
    dense = Dense(np.eye(3, dtype=np.float32), 0 * one, False)
    fused = Encoder((dense, LayerNorm(2 * one, one), dense), (3,), one, 2 * one).fused()
    assert [type(layer).__name__ for layer in fused.layers] == ["Dense", "RmsNorm", "Dense"]
    assert fused.layers[0].weight == pytest.approx(0.5 * (np.eye(3) - 1 / 3), abs=1e-6)
    assert fused.layers[0].bias == pytest.approx(np.zeros(3), abs=1e-6)
    assert fused.layers[2].weight == pytest.approx(2.0 * np.eye(3))
    assert fused.layers[2].bias == pytest.approx(np.ones(3))
    ends = Encoder((dense, LayerNorm(2 * one, one)), (3,), one, 2 * one)
    assert ends.fused().layers[1] is ends.layers[1], "nothing comes after it to take in its scale"


def test_what_takes_images_is_left_as_it_is() -> None:
    one = np.ones(1, np.float32)
    encoder = Encoder((CentreCrop(2), Flatten()), (1, 4, 4), 0 * one, one)
    assert encoder.fused() is encoder
