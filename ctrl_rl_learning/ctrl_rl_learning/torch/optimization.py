"""Steps of optimisers, their learning rates, and target networks that follow."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import torch
from torch import Tensor, nn


def gradient_step(
    optimizers: torch.optim.Optimizer | Sequence[torch.optim.Optimizer],
    losses: Tensor | Sequence[Tensor],
    *clipped: Iterable[nn.Parameter],
    largest_norm: float = math.inf,
) -> None:
    """Go down losses by one step, with one backward pass.

    Args:
        optimizers: Optimiser of the parameters, or several.
        losses: Loss, a single number, or several.
        clipped: Parameters of each network whose gradient is cut to a norm.
        largest_norm: Norm that each of these gradients is cut to.
    """
    each = (optimizers,) if isinstance(optimizers, torch.optim.Optimizer) else optimizers
    for optimizer in each:
        optimizer.zero_grad()
    torch.autograd.backward(losses)
    for parameters in clipped:
        nn.utils.clip_grad_norm_(parameters, largest_norm)
    for optimizer in each:
        optimizer.step()


def anneal_lr(optimizers: Iterable[torch.optim.Optimizer], rate: float, done: float) -> None:
    """Set the learning rate when a part of all updates is done, 0 to 1: it falls along a half cosine to 0."""
    for optimizer in optimizers:
        for group in optimizer.param_groups:
            group["lr"] = 0.5 * (1.0 + math.cos(math.pi * done)) * rate


def polyak_update(target: nn.Module, source: nn.Module, share: float) -> None:
    """Move a target network by a share of the way to its source."""
    with torch.no_grad():
        for slow, fast in zip(target.parameters(), source.parameters(), strict=True):
            slow.lerp_(fast, share)
