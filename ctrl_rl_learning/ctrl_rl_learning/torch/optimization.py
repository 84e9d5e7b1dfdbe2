"""Optimiser steps, learning-rate schedules and target-network updates."""

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
    """Take one optimiser step on the losses, with one backward pass.

    Args:
        optimizers: Optimiser of the parameters, or several.
        losses: Scalar loss, or several.
        clipped: Parameters of each network whose gradient norm is clipped.
        largest_norm: Maximum norm of each of these gradients.
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
    """Set the learning rate on a half-cosine schedule to 0, given the fraction of updates done (0 to 1)."""
    for optimizer in optimizers:
        for group in optimizer.param_groups:
            group["lr"] = 0.5 * (1.0 + math.cos(math.pi * done)) * rate


def polyak_update(target: nn.Module, source: nn.Module, share: float) -> None:
    """Move a target network towards its source by a fraction of the difference."""
    with torch.no_grad():
        for slow, fast in zip(target.parameters(), source.parameters(), strict=True):
            slow.lerp_(fast, share)
