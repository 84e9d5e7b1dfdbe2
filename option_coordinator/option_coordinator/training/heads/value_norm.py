"""Normalisation of value targets to mean 0 and standard deviation 1, as in MAPPO."""

from __future__ import annotations

import torch
from torch import Tensor, nn

_KEEP = 0.99999


class ValueNorm(nn.Module):
    """Running mean and standard deviation of the targets so far; 0 and 1 before the first."""

    mean: Tensor
    square: Tensor
    weight: Tensor

    def __init__(self) -> None:
        super().__init__()
        for name in ("mean", "square", "weight"):
            self.register_buffer(name, torch.zeros(()))

    def count(self, targets: Tensor) -> Tensor:
        """Count targets (B,) in and return them on the scale."""
        with torch.no_grad():
            self.mean.mul_(_KEEP).add_((1.0 - _KEEP) * targets.mean())
            self.square.mul_(_KEEP).add_((1.0 - _KEEP) * (targets * targets).mean())
            self.weight.mul_(_KEEP).add_(1.0 - _KEEP)
        mean, spread = self._moments()
        return (targets - mean) / spread

    def undo(self, scaled: Tensor) -> Tensor:
        """Return values in units of reward (B,)."""
        mean, spread = self._moments()
        return scaled * spread + mean

    def _moments(self) -> tuple[Tensor, Tensor]:
        if self.weight == 0.0:
            return self.mean, torch.ones_like(self.mean)
        mean = self.mean / self.weight
        return mean, (self.square / self.weight - mean * mean).clamp(min=1e-2).sqrt()
