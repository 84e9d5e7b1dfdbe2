"""The networks around the linear controller: encoders of vectors and of images, and SAC's two critics."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from koopman_lqr_controller import encoder as deployed
from koopman_lqr_controller.training.contrastive import centre_crop

_FILTERS, _KERNEL = 32, 3


class TorchEncoder(nn.Module):
    """psi: normalise, hidden layers with ReLU, a linear layer, LayerNorm.

    Attributes:
        shape: of an observation.
        crop: rows and columns of an image that are looked at, its middle; None for all, and for vectors.
        layers: in their order.
    """

    middle: Tensor
    unit: Tensor

    def __init__(
        self,
        shape: tuple[int, ...],
        latent: int,
        hidden: int,
        depth: int,
        middle: Tensor,
        unit: Tensor,
        crop: int | None = None,
    ) -> None:
        """Make one with random weights.

        Args:
            shape: (n,) of a vector or (channels, height, width) of an image.
            latent: dimension of z.
            hidden: units of each hidden layer; filters are `_FILTERS`.
            depth: hidden layers, or convolutions of an image.
            middle: what becomes 0; broadcasts to `shape`.
            unit: what becomes 1 above it.
            crop: see above.
        """
        super().__init__()
        self.shape, self.crop = shape, crop
        self.register_buffer("middle", middle)
        self.register_buffer("unit", unit)
        seen = shape if crop is None else (shape[0], crop, crop)
        body = _convolutions(shape, depth) if len(shape) == 3 else _dense(shape[0], hidden, depth)
        with torch.no_grad():
            width = int(nn.Sequential(*body)(torch.zeros(1, *seen)).shape[1])
        self.layers = nn.Sequential(*body, nn.Linear(width, latent), nn.LayerNorm(latent))

    def forward(self, x: Tensor) -> Tensor:
        """Return z (N, latent) of observations (N, *shape), or of images that are cropped already."""
        if self.crop is not None:
            x = centre_crop(x, self.crop)
        z: Tensor = self.layers((x - self.middle) / self.unit)
        return z

    def deploy(self) -> deployed.Encoder:
        """Return the same encoder without torch."""
        layers: list[deployed.Layer] = [] if self.crop is None else [deployed.CentreCrop(self.crop)]
        modules = list(self.layers)
        for index, module in enumerate(modules):
            if isinstance(module, nn.Linear):
                rectified = index + 1 < len(modules) and isinstance(modules[index + 1], nn.ReLU)
                layers.append(deployed.Dense(_array(module.weight), _array(module.bias), rectified))
            elif isinstance(module, nn.Conv2d):
                assert module.bias is not None
                layers.append(deployed.Convolution(_array(module.weight), _array(module.bias), int(module.stride[0])))
            elif isinstance(module, nn.LayerNorm):
                layers.append(deployed.LayerNorm(_array(module.weight), _array(module.bias)))
            elif isinstance(module, nn.Flatten):
                layers.append(deployed.Flatten())
        return deployed.Encoder(tuple(layers), self.shape, _array(self.middle), _array(self.unit))


def _dense(inputs: int, hidden: int, depth: int) -> list[nn.Module]:
    out: list[nn.Module] = []
    for _ in range(depth):
        out += [nn.Linear(inputs, hidden), nn.ReLU()]
        inputs = hidden
    return out


def _convolutions(shape: tuple[int, ...], depth: int) -> list[nn.Module]:
    """Return convolutions, the first two with stride 2: a quarter of the work of one, at the sizes used here."""
    channels, out = shape[0], list[nn.Module]()
    for index in range(depth):
        out += [nn.Conv2d(channels, _FILTERS, _KERNEL, stride=2 if index < 2 else 1), nn.ReLU()]
        channels = _FILTERS
    return [*out, nn.Flatten()]


class TwinCritic(nn.Module):
    """Q_1 and Q_2 of Eq. 4.10, computed together."""

    def __init__(self, latent: int, controls: int, hidden: int) -> None:
        super().__init__()
        sizes = (latent + controls, hidden, hidden, 1)
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for inputs, outputs in pairwise(sizes):
            reach = inputs**-0.5
            self.weights.append(nn.Parameter((2.0 * torch.rand(2, inputs, outputs) - 1.0) * reach))
            self.biases.append(nn.Parameter((2.0 * torch.rand(2, 1, outputs) - 1.0) * reach))

    def forward(self, z: Tensor, u: Tensor) -> Tensor:
        """Return both values (2, N) of latent states (N, n) and actions (N, m)."""
        x = torch.cat((z, u), dim=1).expand(2, -1, -1)
        last = len(self.weights) - 1
        for index, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = torch.baddbmm(bias, x, weight)
            if index < last:
                x = torch.relu(x)
        return x.squeeze(-1)


def _array(tensor: Tensor) -> NDArray[np.float32]:
    return tensor.detach().cpu().numpy().astype(np.float32).copy()
