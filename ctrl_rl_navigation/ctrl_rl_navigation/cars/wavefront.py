"""Time to reach on a grid of (gear, heading, row, column), spread from the goal in the order of arrival times.

The value of a state is the least, over the arcs that leave it, of the arc's duration and the value at its end, which is
interpolated between four cells. A state's value is final once it is taken out of the queue; when the last of four
neighbouring cells becomes final, the arcs that end between them are evaluated, each once. An interpolated value may be
less than the greatest of its four cells, so a final value may still decrease a little: then it is spread again. This
converges to the same values as iterating over all states, since every update only lowers a value.

The queue has buckets by time, in chunks of a common pool. Values are encoded in one array:
v >= 0 final, -v - 1 for a preliminary value, -inf for none yet, +inf for a state in collision.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

CHUNK = 256
"""Number of entries of a chunk."""
_SPARE = 64
"""Number of free chunks below which the pool must grow: more than one state can use."""
_LEAST_WEIGHT = 0.8
"""Sum of the weights of cells without collision at an arc's end, below which the arc does not count."""
_BETTER = 1e-3
"""Minimum decrease of a final value that is spread again [s]."""
HEAD, FINAL, FREE, NOW = range(4)
"""Places in `counts`: number of the current bucket, final states, free chunks, and entries in the queue."""


class Queue(NamedTuple):
    """Buckets of states by time.

    Attributes:
        entries: States in chunks (chunks, CHUNK); negative, as -1 - state, if a final state is spread again.
        before: For each chunk, the next one of its bucket; -1 for none (chunks,).
        free: Stack of unused chunks (chunks,).
        heads: First chunk of each bucket, -1 for none (buckets,).
        fill: Number of entries in the first chunk of each bucket (buckets,).
        counts: See `HEAD` etc. (4,).
        width: Duration of a bucket [s].
    """

    entries: NDArray[np.int64]
    before: NDArray[np.int64]
    free: NDArray[np.int64]
    heads: NDArray[np.int64]
    fill: NDArray[np.int64]
    counts: NDArray[np.int64]
    width: float


def make_queue(width: float, longest: float, chunks: int = 4096) -> Queue:
    """Create an empty queue.

    Args:
        width: Duration of a bucket [s].
        longest: Maximum increase of a value by one step [s].
        chunks: Number of chunks.
    """
    buckets = math.ceil(longest / width) + 4
    return Queue(
        np.empty((chunks, CHUNK), np.int64),
        np.full(chunks, -1, np.int64),
        np.arange(chunks, dtype=np.int64)[::-1].copy(),
        np.full(buckets, -1, np.int64),
        np.zeros(buckets, np.int64),
        np.array((0, 0, chunks, 0), np.int64),
        width,
    )


def grown(queue: Queue) -> Queue:
    """Return a queue with twice as many chunks and the same entries."""
    count, free = len(queue.before), int(queue.counts[FREE])
    stack = np.empty(2 * count, np.int64)
    stack[:count] = np.arange(count, 2 * count)
    stack[count : count + free] = queue.free[:free]
    counts = queue.counts.copy()
    counts[FREE] = count + free
    return queue._replace(
        entries=np.concatenate((queue.entries, np.empty_like(queue.entries))),
        before=np.concatenate((queue.before, np.full(count, -1, np.int64))),
        free=stack,
        counts=counts,
    )


@njit(inline="always")
def _push(queue: Any, time: float, entry: int) -> None:
    bucket = max(int(time / queue.width), queue.counts[HEAD]) % len(queue.heads)
    chunk = queue.heads[bucket]
    if chunk < 0 or queue.fill[bucket] == CHUNK:
        queue.counts[FREE] -= 1
        taken = queue.free[queue.counts[FREE]]
        queue.before[taken] = chunk
        queue.heads[bucket], queue.fill[bucket] = taken, 0
        chunk = taken
    queue.entries[chunk, queue.fill[bucket]] = entry
    queue.fill[bucket] += 1
    queue.counts[NOW] += 1


@njit(inline="always")
def _pop(queue: Any) -> int:
    """Remove an entry of the earliest bucket; the queue must not be empty."""
    while queue.heads[queue.counts[HEAD] % len(queue.heads)] < 0:
        queue.counts[HEAD] += 1
    bucket = queue.counts[HEAD] % len(queue.heads)
    chunk = queue.heads[bucket]
    queue.fill[bucket] -= 1
    queue.counts[NOW] -= 1
    entry = queue.entries[chunk, queue.fill[bucket]]
    if queue.fill[bucket] == 0:
        queue.heads[bucket] = queue.before[chunk]
        queue.free[queue.counts[FREE]] = chunk
        queue.counts[FREE] += 1
        queue.fill[bucket] = CHUNK if queue.heads[bucket] >= 0 else 0
    return entry


@njit(inline="always")
def _offer(values: Any, waiting: Any, queue: Any, state: int, time: float) -> None:
    """Lower a state's value and queue the state, if the value is lower than before."""
    known = values[state]
    if known < 0.0:
        if time < -known - 1.0:
            values[state] = -time - 1.0
            _push(queue, time, state)
    elif time < known - _BETTER:
        values[state] = time
        if waiting[state] == 0:
            waiting[state] = 1
            _push(queue, (queue.counts[HEAD] + 1.5) * queue.width, -1 - state)


@njit(inline="always")
def _improves(known: float, time: float) -> bool:
    return time < -known - 1.0 if known < 0.0 else time < known - _BETTER and known != np.inf


@njit(inline="always")
def _arrive(
    values: Any, waiting: Any, queue: Any, arcs: Any, gear: int, heading: int, base: int, width: int, aside: float
) -> None:
    """Evaluate all arcs that end between four cells, the first of which is `base`; at least one of them is final."""
    a, b, c, d = values[base], values[base + 1], values[base + width], values[base + width + 1]
    least = min(
        min(a if a >= 0.0 else np.inf, b if b >= 0.0 else np.inf),
        min(c if c >= 0.0 else np.inf, d if d >= 0.0 else np.inf),
    )
    most = least + aside
    free_a, free_b, free_c, free_d = a < np.inf, b < np.inf, c < np.inf, d < np.inf
    a = a if 0.0 <= a < most else most
    b = b if 0.0 <= b < most else most
    c = c if 0.0 <= c < most else most
    d = d if 0.0 <= d < most else most
    all_free = free_a and free_b and free_c and free_d
    for number in range(arcs.times.shape[2]):
        w = arcs.weights[gear, heading, number]
        if all_free:
            time = w[0] * a + w[1] * b + w[2] * c + w[3] * d
        else:
            time = total = 0.0
            for value, weight, free in ((a, w[0], free_a), (b, w[1], free_b), (c, w[2], free_c), (d, w[3], free_d)):
                if free:
                    time += weight * value
                    total += weight
            if total < _LEAST_WEIGHT:
                continue
            time /= total
        time += arcs.times[gear, heading, number]
        start = base + arcs.offsets[gear, heading, number]
        if not _improves(values[start], time):
            continue
        passes = True
        for passed in arcs.passed[gear, heading, number]:
            if passed == 0:
                break
            if values[start + passed] == np.inf:
                passes = False
                break
        if passes:
            _offer(values, waiting, queue, start, time)


@cached_njit
def seed(values: Any, queue: Any, states: NDArray[np.int64]) -> None:
    """Queue states (n,) with the value 0."""
    for state in states:
        if values[state] < 0.0:
            values[state] = -1.0
            _push(queue, 0.0, state)


def _spread(
    values: Any, waiting: Any, queue: Any, arcs: Any, shape: Any, change: float, aside: float, most: int
) -> int:
    headings, height, width = shape
    layer = height * width
    half = headings * layer
    for _ in range(most):
        if queue.counts[NOW] == 0:
            return 0
        if queue.counts[FREE] < _SPARE:
            return -1
        entry = _pop(queue)
        again = entry < 0
        state = -1 - entry if again else entry
        time = values[state]
        if again:
            waiting[state] = 0
        else:
            if time >= 0.0:
                continue
            time = -time - np.float32(1.0)
            values[state] = time
            queue.counts[FINAL] += 1
        gear = 1 if state >= half else 0
        heading = (state - gear * half) // layer
        other = state - half if gear else state + half
        if _improves(values[other], time + change):
            _offer(values, waiting, queue, other, time + change)
        for down in range(2):
            for left in range(2):
                _arrive(values, waiting, queue, arcs, gear, heading, state - down * width - left, width, aside)
    return 1


spread = cached_njit(_spread, nogil=True)
"""Make up to `most` more states final; 0 when the queue is empty, -1 if its pool must grow, else 1."""
