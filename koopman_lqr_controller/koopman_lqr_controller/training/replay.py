"""The replay of Koopman learning: observations in order, each stored once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_learning.torch import ReplayBuffer
from numpy.typing import NDArray

_PREFIX = "replay."


class Later(NamedTuple):
    """Multi-step returns, with fewer steps at the end of an episode.

    Attributes:
        gained: Discounted rewards before the bootstrap (N,).
        x: Observations at the bootstrap (N, *shape).
        weight: Discount of the bootstrap value; 0 after termination (N,).
    """

    gained: NDArray[np.float32]
    x: NDArray[np.generic]
    weight: NDArray[np.float32]


class Transitions(NamedTuple):
    """Steps sampled from a replay.

    Attributes:
        x: Observations (N, *shape).
        u: Actions in [-1, 1] (N, m).
        reward: Reward of each step (N,).
        x_next: Next observations (N, *shape).
        terminated: Whether the episode terminated there, 0 or 1 (N,).
        later: Multi-step returns; None for one-step returns.
    """

    x: NDArray[np.generic]
    u: NDArray[np.float32]
    reward: NDArray[np.float32]
    x_next: NDArray[np.generic]
    terminated: NDArray[np.float32]
    later: Later | None = None


class Sequences(NamedTuple):
    """Sequences of H steps sampled from a replay.

    Attributes:
        place: Index of each sequence in the replay (N,).
        x: Observations (N, H + 1, *shape).
        u: Actions in [-1, 1] (N, H, m).
        reward: Reward of each step (N, H).
        terminated: Whether the episode terminated after a step, 0 or 1 (N, H); later entries belong to other episodes.
    """

    place: NDArray[np.intp]
    x: NDArray[np.generic]
    u: NDArray[np.float32]
    reward: NDArray[np.float32]
    terminated: NDArray[np.float32]


class Mirror(NamedTuple):
    """The left-right symmetry of a task.

    Attributes:
        order: Order of an observation's components with left and right swapped (n,).
        sign: Sign of these components (n,).
        control_sign: Sign of the controls (m,).
    """

    order: NDArray[np.intp]
    sign: NDArray[np.float64]
    control_sign: NDArray[np.float64]

    def mirror_at_random(self, steps: Transitions, random: np.random.Generator) -> Transitions:
        """Return the steps, each mirrored with probability one half."""
        chosen = (random.random(len(steps.u)) < 0.5)[:, None]
        later = steps.later and steps.later._replace(x=self._turned(chosen, steps.later.x))
        return steps._replace(
            x=self._turned(chosen, steps.x),
            u=self._swerved(chosen, steps.u),
            x_next=self._turned(chosen, steps.x_next),
            later=later,
        )

    def mirror_sequences_at_random(self, sequences: Sequences, random: np.random.Generator) -> Sequences:
        """Return the sequences, each mirrored with probability one half."""
        chosen = (random.random(len(sequences.u)) < 0.5)[:, None, None]
        return sequences._replace(x=self._turned(chosen, sequences.x), u=self._swerved(chosen, sequences.u))

    def _turned(self, chosen: NDArray[np.bool_], x: NDArray[np.generic]) -> NDArray[np.generic]:
        return np.where(chosen, x[..., self.order] * self.sign.astype(x.dtype), x)

    def _swerved(self, chosen: NDArray[np.bool_], u: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.where(chosen, u * self.control_sign.astype(np.float32), u)


class Replay:
    """A ring buffer of observations in order; the next observation of a step is the following entry, stored once.

    The last observation of each episode is stored too, but no step starts there. Of stacked images only the newest is
    stored; earlier ones are taken from the previous entries.
    """

    def __init__(self, capacity: int, shape: tuple[int, ...], controls: int, kind: type[np.generic]) -> None:
        """Create an empty replay.

        Args:
            capacity: Maximum number of observations.
            shape: Shape of an observation: (n,) for a vector, or (images, height, width), oldest first; at the start of
                an episode, the first image is repeated.
            controls: Number of controls.
            kind: Data type of an observation.
        """
        self._pictures = shape[0] if len(shape) == 3 else 0
        columns: dict[str, NDArray[Any]] = {
            "x": np.zeros((capacity, *(shape[1:] if self._pictures else shape)), kind),
            "u": np.zeros((capacity, controls), np.float32),
            "reward": np.zeros(capacity, np.float32),
            "terminated": np.zeros(capacity, np.float32),
            "begins": np.zeros(capacity, np.bool_),
            "age": np.zeros(capacity, np.int32),
        }
        self._ring, self._age = ReplayBuffer(capacity, columns), 0

    def add(self, x: NDArray[np.generic], u: NDArray[np.float32], reward: float, terminated: bool) -> None:
        """Add a step that starts at x; its next observation is the one added next."""
        self._put(x, u, reward, terminated, True)

    def end_episode(self, x: NDArray[np.generic]) -> None:
        """Add an episode's last observation."""
        self._put(x, np.float32(0.0), 0.0, False, False)
        self._age = 0

    def _put(self, x: NDArray[np.generic], u: NDArray[np.float32] | np.float32, *rest: float) -> None:
        values = (x[-1] if self._pictures else x, u, *rest, self._age)
        self._ring.add({name: np.asarray(value)[None] for name, value in zip(self._ring.columns, values, strict=True)})
        self._age += 1

    def draw(self, count: int, random: np.random.Generator, ahead: int = 1, discount: float = 1.0) -> Transitions:
        """Sample steps uniformly with replacement; at least one step must be complete.

        Args:
            count: Number of steps.
            random: Random generator.
            ahead: Number of steps before bootstrapping.
            discount: Discount per step.
        """
        chosen = np.zeros(0, np.intp)
        while len(chosen) < count:
            index = random.integers(len(self._ring), size=count)
            chosen = np.concatenate((chosen, index[self._complete(index)]))
        steps = self._take(chosen[:count])
        return steps if ahead == 1 else steps._replace(later=self._later(chosen[:count], ahead, discount))

    def _later(self, index: NDArray[np.intp], ahead: int, discount: float) -> Later:
        """Return the multi-step returns after a number of steps, or at the end of the stored part of the episode."""
        a, capacity = self._ring.columns, self._ring.capacity
        at, goes_on = index, np.ones(len(index), np.bool_)
        gained, weight = np.zeros(len(index)), np.ones(len(index))
        for _ in range(ahead):
            goes_on = goes_on & a["begins"][at].astype(np.bool_) & (at != (self._ring.seen - 1) % capacity)
            gained += goes_on * weight * a["reward"][at]
            weight = np.where(goes_on, weight * discount * (1.0 - a["terminated"][at]), weight)
            at = np.where(goes_on, (at + 1) % capacity, at)
        return Later(gained.astype(np.float32), self._observation(at), weight.astype(np.float32))

    def _complete(self, index: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return whether a complete step starts at an entry, with its next observation and earlier images stored."""
        capacity, seen = self._ring.capacity, self._ring.seen
        newest = (seen - 1) % capacity
        kept = (index - seen) % capacity if seen >= capacity else index
        whole = kept >= self._before(index, self._pictures - 1)
        return self._ring.columns["begins"][index].astype(np.bool_) & (index != newest) & whole

    def _before(self, index: NDArray[np.intp], most: int) -> NDArray[np.intp]:
        """Return the number of entries between an observation's oldest and newest image, up to a maximum."""
        return np.minimum(self._ring.columns["age"][index].astype(np.intp), max(0, most))

    def _observation(self, index: NDArray[np.intp]) -> NDArray[np.generic]:
        x = self._ring.columns["x"]
        if not self._pictures:
            return x[index]
        steps = range(self._pictures - 1, -1, -1)
        return np.stack([x[(index - self._before(index, most)) % len(x)] for most in steps], axis=1)

    def _take(self, index: NDArray[np.intp]) -> Transitions:
        a, after = self._ring.columns, (index + 1) % self._ring.capacity
        return Transitions(
            x=self._observation(index),
            u=a["u"][index].astype(np.float32, copy=False),
            reward=a["reward"][index].astype(np.float32, copy=False),
            x_next=self._observation(after),
            terminated=a["terminated"][index].astype(np.float32, copy=False),
        )

    def everything(self) -> Transitions:
        """Return all complete steps, oldest episodes first unless the ring has wrapped around."""
        index = np.arange(len(self._ring))
        return self._take(index[self._complete(index)])

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the full state for a checkpoint: columns, next index, whether the ring has wrapped, and age."""
        out = {_PREFIX + name: column for name, column in self._ring.arrays().items() if name in self._ring.columns}
        full, end = divmod(self._ring.seen, self._ring.capacity)
        return {**out, _PREFIX + "end": np.array([end, full > 0, self._age], np.int64)}

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore the state returned by `arrays`; other arrays are ignored."""
        for name, column in self._ring.columns.items():
            kept = arrays[_PREFIX + name]
            column[: len(kept)] = kept
        end, full, self._age = (int(value) for value in arrays[_PREFIX + "end"])
        self._ring.seen = end + full * self._ring.capacity


class SequenceReplay(Replay):
    """A replay of H-step sequences, sampled in proportion to their errors (Fujimoto et al. 2020).

    New sequences have the priority of the largest error. A sequence lies within an episode, or ends with a terminated
    one.

    Args:
        capacity: Maximum number of observations.
        shape: Shape of an observation (n,).
        controls: Number of controls.
        kind: Data type of an observation.
        length: Number H of steps.
    """

    def __init__(
        self, capacity: int, shape: tuple[int, ...], controls: int, kind: type[np.generic], length: int
    ) -> None:
        super().__init__(capacity, shape, controls, kind)
        self._length, self._priority, self._largest = length, np.zeros(capacity), 1.0

    @property
    def ready(self) -> bool:
        """Whether a sequence is available."""
        return bool(self._priority.any())

    def draw_sequences(self, count: int, random: np.random.Generator) -> Sequences:
        """Sample sequences by priority with replacement; at least one must be available, see `ready`."""
        total = np.cumsum(self._priority[: len(self._ring)])
        found = np.searchsorted(total, random.random(count) * total[-1], side="right")
        first = np.minimum(found, np.searchsorted(total, total[-1]))
        a = self._ring.columns
        places = (first[:, None] + np.arange(self._length + 1)) % self._ring.capacity
        steps = places[:, :-1]
        return Sequences(first, a["x"][places], a["u"][steps], a["reward"][steps], a["terminated"][steps])

    def set_priority(self, place: NDArray[np.intp], priority: NDArray[np.floating]) -> None:
        """Set the relative sampling frequency (N,) of sequences (N,)."""
        self._priority[place] = priority
        self._largest = max(self._largest, float(priority.max()))

    def end_episode(self, x: NDArray[np.generic]) -> None:
        """Add an episode's last observation."""
        steps = self._age
        super().end_episode(x)
        last, capacity = self._ring.seen - 1, self._ring.capacity
        if self._ring.columns["terminated"][(last - 1) % capacity]:
            whole = last - 1 - np.arange(min(steps, self._length - 1))
            self._priority[whole % capacity] = self._largest

    def _put(self, x: NDArray[np.generic], u: NDArray[np.float32] | np.float32, *rest: float) -> None:
        place, capacity = self._ring.seen, self._ring.capacity
        super()._put(x, u, *rest)
        self._priority[place % capacity] = 0.0
        if self._age > self._length:
            self._priority[(place - self._length) % capacity] = self._largest

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the full state for a checkpoint."""
        kept = {"priority": self._priority[: len(self._ring)], "largest": np.array(self._largest)}
        return {**super().arrays(), **{_PREFIX + name: array for name, array in kept.items()}}

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore the state returned by `arrays`; other arrays are ignored."""
        super().restore(arrays)
        priority = arrays[_PREFIX + "priority"]
        self._priority[: len(priority)] = priority
        self._largest = arrays[_PREFIX + "largest"].item()
