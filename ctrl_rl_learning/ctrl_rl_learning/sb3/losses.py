"""Losses and entropy of an algorithm of Stable-Baselines3 while it learns, for the curves of a run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger

_PREFIX = "train/"
_SETTINGS = frozenset({"n_updates", "learning_rate", "clip_range", "clip_range_vf"})
_SAMPLED = 256


class LossLogger(Logger):
    """Keeps what the updates of an algorithm log; nothing is printed or written."""

    def __init__(self) -> None:
        super().__init__(None, [])
        self._logged: dict[str, list[float]] = {}

    def record(self, key: str, value: Any, exclude: str | tuple[str, ...] | None = None) -> None:
        """Keep one figure."""
        super().record(key, value, exclude)
        name = key.removeprefix(_PREFIX)
        if name != key and name not in _SETTINGS and math.isfinite(float(value)):
            self._logged.setdefault(name, []).append(float(value))

    def take(self) -> dict[str, float]:
        """Return the means since the last call; `loss` and, of a random policy, `entropy` are there for every one."""
        means = {name: float(np.mean(values)) for name, values in self._logged.items()}
        self._logged = {}
        if "entropy_loss" in means:
            means["entropy"] = -means.pop("entropy_loss")
        if "policy_objective" in means:
            means.setdefault("loss", -means["policy_objective"])
        if "critic_loss" in means:
            means.setdefault("loss", means["critic_loss"])
        return means


def listen(model: BaseAlgorithm) -> LossLogger:
    """Return the logger that an algorithm has from now on."""
    logger = LossLogger()
    model.set_logger(logger)
    return logger


def entropy_of(model: BaseAlgorithm) -> dict[str, float]:
    """Return the `entropy` of a soft actor-critic's policy, which it does not log; nothing of other algorithms.

    What learning draws afterwards is the same as without this.
    """
    replay = getattr(model, "replay_buffer", None)
    if not isinstance(model, SAC) or replay is None or not replay.size():
        return {}
    seen = replay.observations[np.random.default_rng(0).integers(replay.size(), size=_SAMPLED), 0]
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        _, log_density = model.actor.action_log_prob(replay.to_torch(seen))
    return {"entropy": -float(log_density.mean())}
