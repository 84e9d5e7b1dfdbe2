"""The contrastive loss of the encoder and the augmentations that it compares (thesis Eq. 4.4, 4.5)."""

from __future__ import annotations

import torch
from torch import Tensor


def info_nce(queries: Tensor, keys: Tensor, W: Tensor) -> Tensor:
    """Return the mean of -log of Eq. 4.4: how badly each query finds its own key among all keys.

    Args:
        queries: z^q (N, n).
        keys: z^k (N, n); row i belongs to query i, all others are its negatives.
        W: Matrix of the bilinear similarity z^q^T W z^k (n, n).
    """
    similarity = queries @ W @ keys.T
    return torch.nn.functional.cross_entropy(similarity, torch.arange(len(queries), device=queries.device))


def noisy(x: Tensor, eta: float, generator: torch.Generator) -> Tensor:
    """Return x + dx, dx uniform in -eta |x| .. eta |x| (Eq. 4.5).

    Args:
        x: Observations (N, ...).
        eta: Relative size of the noise.
        generator: On the CPU.
    """
    share = torch.rand(x.shape, generator=generator).to(x.device)
    return x + eta * x.abs() * (2.0 * share - 1.0)


def random_crop(images: Tensor, size: int, generator: torch.Generator) -> Tensor:
    """Return from each image a window of its own, drawn uniformly.

    Args:
        images: (N, channels, height, width).
        size: Rows and columns of a window.
        generator: On the CPU.
    """
    count, _, height, width = images.shape
    tops = torch.randint(height - size + 1, (count,), generator=generator).tolist()
    lefts = torch.randint(width - size + 1, (count,), generator=generator).tolist()
    windows = zip(images, tops, lefts, strict=True)  # far quicker than one look-up of all pixels
    return torch.stack([image[:, top : top + size, left : left + size] for image, top, left in windows])


def centre_crop(images: Tensor, size: int) -> Tensor:
    """Return the middle window (..., size, size) of images (..., height, width)."""
    top, left = ((length - size) // 2 for length in images.shape[-2:])
    return images[..., top : top + size, left : left + size]
