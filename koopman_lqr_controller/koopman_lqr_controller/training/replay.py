"""The replay of Koopman learning: observations in their order, each kept once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_learning.torch import ReplayBuffer
from numpy.typing import NDArray

_PREFIX = "replay."


class Later(NamedTuple):
    """Where the goals of values go on after several steps, fewer where an episode ends.

    Attributes:
        gained: Discounted rewards until then (N,).
        x: Observations then (N, *shape).
        weight: Discount of what follows, 0 where nothing does (N,).
    """

    gained: NDArray[np.float32]
    x: NDArray[np.generic]
    weight: NDArray[np.float32]


class Transitions(NamedTuple):
    """Steps drawn from a replay.

    Attributes:
        x: Observations (N, *shape).
        u: Actions in [-1, 1] (N, m).
        reward: Reward of each step (N,).
        x_next: Observations that followed (N, *shape).
        terminated: Whether nothing comes after these, 0 or 1 (N,).
        later: Where values go on after more steps; None where they do after this one.
    """

    x: NDArray[np.generic]
    u: NDArray[np.float32]
    reward: NDArray[np.float32]
    x_next: NDArray[np.generic]
    terminated: NDArray[np.float32]
    later: Later | None = None


class Sequences(NamedTuple):
    """Stretches of H steps drawn from a replay.

    Attributes:
        place: Place of each in the replay (N,).
        x: Observations (N, H + 1, *shape).
        u: Actions in [-1, 1] (N, H, m).
        reward: Reward of each step (N, H).
        terminated: Whether nothing comes after a step, 0 or 1 (N, H); what is behind it belongs to others.
    """

    place: NDArray[np.intp]
    x: NDArray[np.generic]
    u: NDArray[np.float32]
    reward: NDArray[np.float32]
    terminated: NDArray[np.float32]


class Mirror(NamedTuple):
    """The symmetry of a task whose left and right are alike.

    Attributes:
        order: Order of an observation's components when left and right are swapped (n,).
        sign: Sign of these components (n,).
        control_sign: Sign of the controls (m,).
    """

    order: NDArray[np.intp]
    sign: NDArray[np.float64]
    control_sign: NDArray[np.float64]

    def mirror_at_random(self, steps: Transitions, random: np.random.Generator) -> Transitions:
        """Return the steps, each as it was or mirrored, by lot."""
        chosen = (random.random(len(steps.u)) < 0.5)[:, None]
        later = steps.later and steps.later._replace(x=self._turned(chosen, steps.later.x))
        return steps._replace(
            x=self._turned(chosen, steps.x),
            u=self._swerved(chosen, steps.u),
            x_next=self._turned(chosen, steps.x_next),
            later=later,
        )

    def mirror_sequences_at_random(self, sequences: Sequences, random: np.random.Generator) -> Sequences:
        """Return the sequences, each as it was or mirrored, by lot."""
        chosen = (random.random(len(sequences.u)) < 0.5)[:, None, None]
        return sequences._replace(x=self._turned(chosen, sequences.x), u=self._swerved(chosen, sequences.u))

    def _turned(self, chosen: NDArray[np.bool_], x: NDArray[np.generic]) -> NDArray[np.generic]:
        return np.where(chosen, x[..., self.order] * self.sign.astype(x.dtype), x)

    def _swerved(self, chosen: NDArray[np.bool_], u: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.where(chosen, u * self.control_sign.astype(np.float32), u)


class Replay:
    """A ring of observations in the order they were met: the next one of a step lies behind it and is kept once.

    The last observation of each episode is kept too; no step begins there. Of an observation that is the last few
    pictures only the newest is kept: those before it are those of the observations before it.
    """

    def __init__(self, capacity: int, shape: tuple[int, ...], controls: int, kind: type[np.generic]) -> None:
        """Make an empty one.

        Args:
            capacity: Largest number of observations.
            shape: Shape of an observation: (n,) for a vector, or (pictures, height, width), oldest first, the first
                one of an episode repeated where there is none before it.
            controls: Number of controls.
            kind: Type of an observation's entries.
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
        """Add a step that begins at x; what follows it is what is added next."""
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
        """Return steps drawn uniformly with replacement; at least one must be complete.

        Args:
            count: Number of steps.
            random: Generator that draws.
            ahead: Number of steps after which values go on.
            discount: Discount of these.
        """
        chosen = np.zeros(0, np.intp)
        while len(chosen) < count:
            index = random.integers(len(self._ring), size=count)
            chosen = np.concatenate((chosen, index[self._complete(index)]))
        steps = self._take(chosen[:count])
        return steps if ahead == 1 else steps._replace(later=self._later(chosen[:count], ahead, discount))

    def _later(self, index: NDArray[np.intp], ahead: int, discount: float) -> Later:
        """Return where values of steps go on after so many steps, or where the known part of the episode ends."""
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
        """Return whether a step begins there whose next observation is there, and so are the pictures before it."""
        capacity, seen = self._ring.capacity, self._ring.seen
        newest = (seen - 1) % capacity
        kept = (index - seen) % capacity if seen >= capacity else index
        whole = kept >= self._before(index, self._pictures - 1)
        return self._ring.columns["begins"][index].astype(np.bool_) & (index != newest) & whole

    def _before(self, index: NDArray[np.intp], most: int) -> NDArray[np.intp]:
        """Return how many places an observation's oldest picture is before its newest, at most so many."""
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
        """Return all complete steps, oldest episodes first unless it has turned around."""
        index = np.arange(len(self._ring))
        return self._take(index[self._complete(index)])

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything, for a checkpoint: columns, and the next place, whether it has turned around, and age."""
        out = {_PREFIX + name: column for name, column in self._ring.arrays().items() if name in self._ring.columns}
        full, end = divmod(self._ring.seen, self._ring.capacity)
        return {**out, _PREFIX + "end": np.array([end, full > 0, self._age], np.int64)}

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Take up what `arrays` returned; others may lie among them."""
        for name, column in self._ring.columns.items():
            kept = arrays[_PREFIX + name]
            column[: len(kept)] = kept
        end, full, self._age = (int(value) for value in arrays[_PREFIX + "end"])
        self._ring.seen = end + full * self._ring.capacity


class SequenceReplay(Replay):
    """A replay of stretches of H steps, drawn the more often the larger their errors were (Fujimoto et al. 2020).

    What was not drawn yet comes as often as what had the largest error. A stretch lies within an episode, or ends with
    one that terminated.

    Args:
        capacity: Largest number of observations.
        shape: Shape of an observation (n,).
        controls: Number of controls.
        kind: Type of an observation's entries.
        length: Number H of steps.
    """

    def __init__(
        self, capacity: int, shape: tuple[int, ...], controls: int, kind: type[np.generic], length: int
    ) -> None:
        super().__init__(capacity, shape, controls, kind)
        self._length, self._priority, self._largest = length, np.zeros(capacity), 1.0

    @property
    def ready(self) -> bool:
        """Whether there is a stretch to draw."""
        return bool(self._priority.any())

    def draw_sequences(self, count: int, random: np.random.Generator) -> Sequences:
        """Return stretches drawn by their priorities with replacement; there must be one, see `ready`."""
        total = np.cumsum(self._priority[: len(self._ring)])
        found = np.searchsorted(total, random.random(count) * total[-1], side="right")
        first = np.minimum(found, np.searchsorted(total, total[-1]))
        a = self._ring.columns
        places = (first[:, None] + np.arange(self._length + 1)) % self._ring.capacity
        steps = places[:, :-1]
        return Sequences(first, a["x"][places], a["u"][steps], a["reward"][steps], a["terminated"][steps])

    def set_priority(self, place: NDArray[np.intp], priority: NDArray[np.floating]) -> None:
        """Set how often stretches (N,) are drawn from now on, relative to others (N,)."""
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
        """Return everything, for a checkpoint."""
        kept = {"priority": self._priority[: len(self._ring)], "largest": np.array(self._largest)}
        return {**super().arrays(), **{_PREFIX + name: array for name, array in kept.items()}}

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Take up what `arrays` returned; others may lie among them."""
        super().restore(arrays)
        priority = arrays[_PREFIX + "priority"]
        self._priority[: len(priority)] = priority
        self._largest = arrays[_PREFIX + "largest"].item()
