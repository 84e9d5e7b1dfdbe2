"""Records of training: state visit counts (thesis Fig. 3.7) and the algorithm's losses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from ctrl_rl_core.io import FileError, encode_tensors, raise_as, read_tensors
from ctrl_rl_core.tasks import ANGLES
from numpy.typing import NDArray
from stable_baselines3 import SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger

from ctrl_rl_core import NavigationTask, atomic_write, position_indices
from ctrl_rl_learning.errors import LearningError

FORMAT = "visits-1"
_HEADER_KEY = "visits"
PLACES = 50
"""Number of bins along each side of the walled area."""
TURNS = 72
"""Number of bins of the angle, from -pi to pi."""

Counts = NDArray[np.uint32]


class Visits:
    """Visit counts by position and by angle, one set per iteration."""

    def __init__(self, task: NavigationTask) -> None:
        names = task.system.build().state_names
        self._places = position_indices(names)
        self._angle = next(index for index, name in enumerate(names) if name in ANGLES)
        self._edges = [np.linspace(side.low, side.high, PLACES + 1) for side in task.plane_bounds.values()]
        self._turns = np.linspace(-np.pi, np.pi, TURNS + 1)
        self._places_met: list[Counts] = []
        self._turns_met: list[Counts] = []
        self._met: list[NDArray[np.float64]] = []

    def add(self, states: list[NDArray[np.float64]]) -> None:
        """Add states (n,)."""
        self._met += states

    def end_iteration(self) -> None:
        """Count the states added since the last iteration."""
        states = np.array(self._met).reshape(len(self._met), -1)
        self._met = []
        x, y = (states[:, index] if len(states) else np.empty(0) for index in self._places)
        angles = states[:, self._angle] if len(states) else np.empty(0)
        self._places_met.append(np.histogram2d(x, y, self._edges)[0].astype(np.uint32))
        self._turns_met.append(np.histogram(angles, self._turns)[0].astype(np.uint32))

    def counts(self) -> dict[str, Counts]:
        """Return `places` (iterations, PLACES, PLACES) and `turns` (iterations, TURNS)."""
        return {
            "places": np.array(self._places_met, dtype=np.uint32).reshape(-1, PLACES, PLACES),
            "turns": np.array(self._turns_met, dtype=np.uint32).reshape(-1, TURNS),
        }

    def with_counts(self, counts: Mapping[str, NDArray[Any]]) -> Self:
        """Restore the counts of earlier iterations and return self."""
        self._places_met, self._turns_met = list(counts["places"]), list(counts["turns"])
        return self

    def save(self, path: Path) -> None:
        """Write the counts to a file atomically."""
        atomic_write(path, encode_tensors(self.counts(), _HEADER_KEY, {"format": FORMAT}))


def load_visits(path: Path) -> dict[str, Counts]:
    """Return the counts in a file, see `Visits.counts`.

    Raises:
        LearningError: it is no such file.
    """
    with raise_as(LearningError, path):
        header, counts, _ = read_tensors(path, _HEADER_KEY, largest=None, types=("U32",))
        shapes = {name: counts[name].shape[1:] for name in sorted(counts)}
        if header not in ({}, {"format": FORMAT}) or shapes != {"places": (PLACES, PLACES), "turns": (TURNS,)}:
            raise FileError("holds no visit counts")
    return counts


_PREFIX = "train/"
_SETTINGS = frozenset({"n_updates", "learning_rate", "clip_range", "clip_range_vf"})
_SAMPLED = 256


class LossLogger(Logger):
    """Logger that collects the figures of an algorithm's updates without printing or writing them."""

    def __init__(self) -> None:
        super().__init__(None, [])
        self._logged: dict[str, list[float]] = {}

    def record(self, key: str, value: Any, exclude: str | tuple[str, ...] | None = None) -> None:
        """Store one figure."""
        super().record(key, value, exclude)
        name = key.removeprefix(_PREFIX)
        if name != key and name not in _SETTINGS and math.isfinite(float(value)):
            self._logged.setdefault(name, []).append(float(value))

    def take(self) -> dict[str, float]:
        """Return the means since the last call; always with `loss`, and `entropy` for a stochastic policy."""
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
    """Give an algorithm a `LossLogger` and return it."""
    logger = LossLogger()
    model.set_logger(logger)
    return logger


def entropy_of(model: BaseAlgorithm) -> dict[str, float]:
    """Return the policy `entropy` of soft actor-critic, which does not log it; empty for other algorithms.

    The random numbers that learning draws afterwards are unaffected.
    """
    replay = getattr(model, "replay_buffer", None)
    if not isinstance(model, SAC) or replay is None or not replay.size():
        return {}
    seen = replay.observations[np.random.default_rng(0).integers(replay.size(), size=_SAMPLED), 0]
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        _, log_density = model.actor.action_log_prob(replay.to_torch(seen))
    return {"entropy": -float(log_density.mean())}
