"""The deployed encoder computes the same as the learnt one, without torch."""

import json

import numpy as np
import pytest
import torch
from koopman_lqr_controller.models.encoder import EPSILON, Dense, LayerNorm
from koopman_lqr_controller.training.networks.networks import TorchEncoder

from koopman_lqr_controller import Encoder, KoopmanError

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
    with pytest.raises(KoopmanError, match="layer 1 is of an unknown kind: must be one of dense"):
        Encoder.build(description, tensors)


def test_what_makes_it_quick_changes_no_bit() -> None:
    """A single observation, by the plain formulas."""
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
