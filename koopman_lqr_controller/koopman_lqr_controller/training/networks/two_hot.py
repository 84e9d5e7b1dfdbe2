"""Numbers as distributions over bins: targets of a cross entropy, whose gradients do not grow with the number."""

from __future__ import annotations

import torch
from torch import Tensor


def symmetric_bins(largest: float, count: int) -> Tensor:
    """Return the values (count,) of the bins, from -(e^largest - 1) to e^largest - 1, denser around 0."""
    steps = torch.linspace(-largest, largest, count)
    return steps.sign() * steps.abs().expm1()


def two_hot(numbers: Tensor, bins: Tensor) -> Tensor:
    """Return distributions (..., bins) over the two bins nearest to numbers (...), with these numbers as means."""
    inside = numbers.clamp(bins[0], bins[-1]).contiguous()
    above = torch.searchsorted(bins, inside).clamp(1, len(bins) - 1)
    low, high = bins[above - 1], bins[above]
    share = ((inside - low) / (high - low))[..., None]
    shares = torch.zeros(*numbers.shape, len(bins), device=numbers.device)
    shares.scatter_(-1, above[..., None] - 1, 1.0 - share)
    return shares.scatter_(-1, above[..., None], share)


def cross_entropy(logits: Tensor, numbers: Tensor, bins: Tensor) -> Tensor:
    """Return the cross entropy (...) of logits (..., bins) against numbers (...)."""
    return -(two_hot(numbers, bins) * torch.log_softmax(logits, dim=-1)).sum(dim=-1)
