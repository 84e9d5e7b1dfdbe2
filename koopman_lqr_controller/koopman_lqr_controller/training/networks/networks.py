"""The networks around the linear controller: encoders of vectors and images, and their decoder."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models import encoder as deployed

_KERNEL = 3
_LEAST_DEVIATION = 1e-3
"""Term added to the standard deviation of observations, since a component may be constant."""


class TorchEncoder(nn.Module):
    """Encoder psi: normalisation, hidden layers with ReLU, a linear layer, LayerNorm; randomly initialised.

    Args:
        shape: Shape (n,) of a vector or (channels, height, width) of an image.
        latent: Dimension of z.
        hidden: Number of units of each hidden layer for vectors.
        depth: Number of hidden layers, or of convolutions for images.
        middle: Value that maps to 0; broadcasts to `shape`.
        unit: Distance from `middle` that maps to 1.
        crop: Size of the central crop of an image; None for no crop, and for vectors.
        halved: Whether all but the last layer are computed in bfloat16 in training.
        normalised: Whether hidden layers for vectors have a LayerNorm before their ReLU.
        behind: Number of hidden layers, of the same size, between the features and the last linear layer.
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
        halved: bool = False,
        normalised: bool = False,
        behind: int = 0,
    ) -> None:
        super().__init__()
        if len(shape) == 3:
            _check_sizes(shape, crop, depth)
        self.shape, self.crop, self._halves = shape, crop, halved
        self.register_buffer("middle", middle)
        self.register_buffer("unit", unit)
        body = _convolutions(shape, depth) if len(shape) == 3 else dense(shape[0], hidden, depth, normalised)
        with torch.no_grad():
            width = int(nn.Sequential(*body)(torch.zeros(1, *self.seen)).shape[1])
        head = dense(width, hidden, behind, normalised)
        last = nn.Linear(hidden if behind else width, latent), nn.LayerNorm(latent)
        self.layers, self._split = nn.Sequential(*body, *head, *last), len(body)

    def forward(self, x: Tensor) -> Tensor:
        """Return z (N, latent) for observations (N, *shape), or for cropped images."""
        return self.latent(self.features(x))

    def features(self, x: Tensor) -> Tensor:
        """Return the features of observations (N, *shape), or of cropped images."""
        x = self.normalise(x)
        if x.dim() == 4:  # channels last is faster
            x = x.contiguous(memory_format=torch.channels_last)
        with self._halved():
            y: Tensor = self.body(x)
        return y

    def latent(self, features: Tensor) -> Tensor:
        """Return z (N, latent) for features."""
        with self._halved():
            y = self.head[:-1](features)
        z: Tensor = self.layers[-1](y.float())
        return z

    @property
    def body(self) -> nn.Sequential:
        """Layers up to the features."""
        return nn.Sequential(*list(self.layers)[: self._split])

    @property
    def head(self) -> nn.Sequential:
        """Layers from the features to z."""
        return nn.Sequential(*list(self.layers)[self._split :])

    def _halved(self) -> torch.autocast:
        return torch.autocast(self.middle.device.type, torch.bfloat16, enabled=self.training and self._halves)

    @property
    def seen(self) -> tuple[int, ...]:
        """Shape of the (cropped) input."""
        return self.shape if self.crop is None else (self.shape[0], self.crop, self.crop)

    def normalise(self, x: Tensor) -> Tensor:
        """Return the input of the first layer (N, *seen)."""
        if self.crop is not None:
            x = centre_crop(x, self.crop)
        return (x - self.middle) / self.unit

    def deploy(self) -> deployed.Encoder:
        """Return the same encoder without torch."""
        layers: list[deployed.Layer] = [] if self.crop is None else [deployed.CentreCrop(self.crop)]
        layers += deploy_layers(self.layers)
        return deployed.Encoder(tuple(layers), self.shape, _array(self.middle), _array(self.unit))


class RunningScale(nn.Module):
    """Running mean and standard deviation of all observations so far, updated one at a time (Welford 1962).

    Args:
        size: Number of components of an observation.

    Attributes:
        count: Number of observations.
        mean: Mean (n,).
        squares: Sum of squared deviations from the mean (n,).
    """

    count: Tensor
    mean: Tensor
    squares: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        self.register_buffer("mean", torch.zeros(size, dtype=torch.float64))
        self.register_buffer("squares", torch.zeros(size, dtype=torch.float64))

    def add(self, x: Tensor) -> None:
        """Add an observation (n,)."""
        self.count += 1.0
        distance = x.to(self.mean.dtype) - self.mean
        self.mean += distance / self.count
        self.squares += distance * (x - self.mean)

    def give(self, encoders: Iterable[TorchEncoder]) -> None:
        """Set the scale of encoders from the statistics."""
        deviation = (self.squares / self.count).sqrt() + _LEAST_DEVIATION
        for encoder in encoders:
            encoder.middle.copy_(self.mean)
            encoder.unit.copy_(deviation)


def _check_sizes(shape: tuple[int, ...], crop: int | None, depth: int) -> None:
    """Raise if nothing would be left of the images.

    Raises:
        KoopmanError: Names the setting.
    """
    if crop is not None and crop > min(shape[1:]):
        raise KoopmanError(f"crop is {crop}: pictures are {shape[1]} x {shape[2]}")
    left = min(shape[1:]) if crop is None else crop
    for index in range(depth):
        left = _convolved(left, index)
    if left < 1:
        raise KoopmanError(f"depth is {depth}: so many convolutions leave nothing of {crop or shape[1]} rows")


def deploy_layers(layers: nn.Sequential) -> list[deployed.Layer]:
    """Convert layers to ones without torch."""
    out: list[deployed.Layer] = []
    modules = list(layers)
    for index, module in enumerate(modules):
        if isinstance(module, nn.Linear):
            rectified = index + 1 < len(modules) and isinstance(modules[index + 1], nn.ReLU)
            out.append(deployed.Dense(_array(module.weight), _array(module.bias), rectified))
        elif isinstance(module, nn.Conv2d):
            assert module.bias is not None
            out.append(deployed.Convolution(_array(module.weight), _array(module.bias), int(module.stride[0])))
        elif isinstance(module, nn.LayerNorm):
            out.append(deployed.LayerNorm(_array(module.weight), _array(module.bias)))
        elif isinstance(module, nn.Flatten):
            out.append(deployed.Flatten())
        elif isinstance(module, nn.ReLU) and isinstance(modules[index - 1], nn.LayerNorm):
            out.append(deployed.Rectifier())
    return out


class Decoder(nn.Module):
    """Network from z to the normalised observation, with the encoder's layers in reverse.

    Attributes:
        layers: Layers in order.
    """

    def __init__(self, seen: tuple[int, ...], latent: int, hidden: int, depth: int) -> None:
        super().__init__()
        if len(seen) == 1:
            self.layers = nn.Sequential(*dense(latent, hidden, depth), nn.Linear(hidden, seen[0]))
        else:
            self.layers = nn.Sequential(*_transposed_convolutions(seen, latent, depth))

    def forward(self, z: Tensor) -> Tensor:
        """Return the reconstruction (N, *seen) of latent states (N, latent)."""
        x: Tensor = self.layers(z)
        return x


def dense(inputs: int, hidden: int, depth: int, normalised: bool = False) -> list[nn.Module]:
    """Create hidden layers with ReLU, each optionally preceded by a LayerNorm."""
    out: list[nn.Module] = []
    for _ in range(depth):
        out += [nn.Linear(inputs, hidden), *([nn.LayerNorm(hidden)] if normalised else []), nn.ReLU()]
        inputs = hidden
    return out


def _convolutions(shape: tuple[int, ...], depth: int) -> list[nn.Module]:
    """Create convolutions, the first three with stride 2, which take a sixth of the time of one at these sizes."""
    channels, out = shape[0], list[nn.Module]()
    for index in range(depth):
        out += [nn.Conv2d(channels, _filters(index), _KERNEL, stride=_stride(index)), nn.ReLU()]
        channels = _filters(index)
    return [*out, nn.Flatten()]


def _filters(index: int) -> int:
    return 16 if index == 0 else 32


def _stride(index: int) -> int:
    return 2 if index < 3 else 1


def _convolved(length: int, index: int) -> int:
    """Return the number of rows after a convolution."""
    return (length - _KERNEL) // _stride(index) + 1


def _transposed_convolutions(seen: tuple[int, ...], latent: int, depth: int) -> list[nn.Module]:
    """Create the exact inverse shapes of `_convolutions`, by transposed convolutions."""
    channels, *size = seen
    sizes = [size]
    for index in range(depth):
        sizes.append([_convolved(length, index) for length in sizes[-1]])
    rows, columns = sizes[-1]
    last = _filters(depth - 1)
    out = [nn.Linear(latent, last * rows * columns), nn.ReLU(), nn.Unflatten(1, (last, rows, columns))]
    for index in reversed(range(depth)):
        stride = _stride(index)
        lost = [
            before - ((after - 1) * stride + _KERNEL)
            for before, after in zip(sizes[index], sizes[index + 1], strict=True)
        ]
        outputs = channels if index == 0 else _filters(index - 1)
        out.append(nn.ConvTranspose2d(_filters(index), outputs, _KERNEL, stride, output_padding=(lost[0], lost[1])))
        if index:
            out.append(nn.ReLU())
    return out


def _array(tensor: Tensor) -> NDArray[np.float32]:
    return tensor.detach().cpu().numpy().astype(np.float32).copy()


def follow(slow: nn.Module, fast: nn.Module, rate: float) -> None:
    """Move one module's parameters towards another's (Polyak averaging)."""
    with torch.no_grad():
        torch._foreach_lerp_(list(slow.parameters()), list(fast.parameters()), rate)


def centre_crop(images: Tensor, size: int) -> Tensor:
    """Return the central window (..., size, size) of images (..., height, width)."""
    top, left = ((length - size) // 2 for length in images.shape[-2:])
    return images[..., top : top + size, left : left + size]
