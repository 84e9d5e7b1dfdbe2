"""One step back in time of a safety value on the whole grid; compiled once for all systems.

    V(z, t) = min{ l(z, t), max{ r(z, t), max over u, min over d of V(z(h), t + h) } }

with the margin l to what must be avoided and the margin r inside the target. All steps have duration h. The nodes of a
block differ only along the inner axes of `solvers.steps` and have the same displacement, so whole planes are summed and
shifted at once. Without inner axes each node has its own step.

Values are stored with ghost nodes around the grid, which copy its edge or, on periodic axes, the opposite end, so no
look-up leaves the array.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ttr_reward_node.kernels.safety_stencil import (
    OPTIONS,
    Floats,
    Integers,
    SafetyTables,
    cubic_at,
    cubic_products,
    cubic_weights,
    linear_at,
    linear_products,
)

_INLINE = {**OPTIONS, "forceinline": True}


class Margins(NamedTuple):
    """Upper and lower bounds of the value at the nodes of the blocks.

    Attributes:
        avoid: Margin l (blocks or 1, block size).
        reach: Margin r (blocks or 1, block size); -inf without a target.
        discount: Weight gamma of the next value in the discounted form; 1 for the undiscounted form.
    """

    avoid: Floats
    reach: Floats
    discount: float


@njit(**OPTIONS)
def step_back(values: Floats, out: Floats, margins: Margins, tables: SafetyTables) -> float:
    """Fill `out` with the values one step earlier than `values`, except the ghosts of the outer axes.

    Args:
        values: Values at the nodes and ghosts, flat.
        out: Values one step earlier, flat.
        margins: Bounds on the value.
        tables: Steps of the blocks.

    Returns:
        The largest change at a node.
    """
    if len(tables.inner) == 0:
        return _step_nodes(values, out, margins, tables)
    return _step_blocks(values, out, margins, tables)


@njit(**OPTIONS)
def _bound(margins: Margins, block: int, at: int, ahead: np.float32) -> np.float32:
    """Return the value at a node from the best value one step ahead."""
    avoid, reach = margins.avoid, margins.reach
    l = avoid[block if len(avoid) > 1 else 0, at]  # noqa: E741 notation of the literature
    r = reach[block if len(reach) > 1 else 0, at]
    ahead = max(r, ahead)
    gamma = np.float32(margins.discount)
    if gamma == np.float32(1.0):
        return min(l, ahead)
    return (np.float32(1.0) - gamma) * (l if r == -np.inf else min(l, r)) + gamma * min(l, ahead)


@njit(**OPTIONS)
def _step_nodes(values: Floats, out: Floats, margins: Margins, tables: SafetyTables) -> float:
    """Update each node separately; skip the remaining disturbances of a control that cannot beat the best one."""
    blocks, pairs, avoid = tables.blocks, tables.corners.shape[1], margins.avoid
    disturbances, width, products = tables.disturbances, tables.width, np.empty(len(tables.pattern), np.float32)
    largest = np.float32(0.0)
    for b in range(len(blocks)):
        best = np.float32(-np.inf)
        enough = avoid[b if len(avoid) > 1 else 0, 0]
        for first in range(0, pairs, disturbances):
            worst = np.float32(np.inf)
            for p in range(first, first + disturbances):
                if width == 4:
                    found = cubic_at(values, tables, b, p, products)
                else:
                    found = linear_at(values, tables, b, p, products)
                worst = min(worst, found)
                if worst <= best:
                    break
            best = max(best, worst)
            if best >= enough:
                break
        new = _bound(margins, b, 0, best)
        largest = max(largest, abs(new - values[blocks[b]]))
        out[blocks[b]] = new
    return float(largest)


@njit(**OPTIONS)
def _step_blocks(values: Floats, out: Floats, margins: Margins, tables: SafetyTables) -> float:
    """Update whole blocks: sum the planes around the end along the outer axes, then shift along the inner axes."""
    blocks, corners, cells, parts, pattern, inner, disturbances, width = tables
    pairs, size, n_inner = corners.shape[1], margins.avoid.shape[1], len(inner)
    n_outer = parts.shape[2] - n_inner
    planes, worst, best = (
        np.zeros((n_inner + 1, size), np.float32),
        np.empty(size, np.float32),
        np.empty(size, np.float32),
    )
    weights, products = np.empty(4, np.float32), np.empty(len(pattern), np.float32)
    # Largest change per position within the blocks: reducing to one number here would take longer than everything else.
    changes = np.zeros(size, np.float32)
    begin, end = _core(inner, n_inner, size)
    for b in range(len(blocks)):
        best[:] = -np.inf
        for p in range(pairs):
            same = p > 0 and corners[b, p] == corners[b, p - 1]
            for k in range(n_outer):
                same = same and parts[b, p, k] == parts[b, p - 1, k]
            if not same:
                if width == 4:
                    number = cubic_products(parts, b, p, n_outer, products)
                else:
                    number = linear_products(parts, b, p, n_outer, products)
                _add_planes(values, corners[b, p], pattern, products[:number], planes[0])
            for i in range(n_inner):
                part = parts[b, p, n_outer + i]
                if width == 4:
                    weights[0], weights[1], weights[2], weights[3] = cubic_weights(part)
                else:
                    weights[0], weights[1] = np.float32(1.0) - part, part
                first, stop = _core(inner, i + 1, size)
                at = first + (cells[b, p, i] - (width // 2 - 1)) * inner[i, 0]
                _shift(planes[i], planes[i + 1, first:stop], weights[:width], at, inner[i, 0])
            found = planes[n_inner]
            if p % disturbances == 0:
                for j in range(begin, end):
                    worst[j] = found[j]
            else:
                for j in range(begin, end):
                    worst[j] = found[j] if found[j] < worst[j] else worst[j]
            if p % disturbances == disturbances - 1:
                for j in range(begin, end):
                    best[j] = worst[j] if worst[j] > best[j] else best[j]
        here = out[blocks[b] : blocks[b] + size]
        old = values[blocks[b] : blocks[b] + size]
        _bound_block(margins, b, best, here)
        _fill_ghosts(here, inner)
        for j in range(size):
            change = abs(here[j] - old[j])
            changes[j] = change if change > changes[j] else changes[j]
    return float(changes.max())


@njit(**OPTIONS)
def _bound_block(margins: Margins, block: int, ahead: Floats, out: Floats) -> None:
    """Apply `_bound` to all nodes of a block."""
    l = margins.avoid[block if len(margins.avoid) > 1 else 0]  # noqa: E741 notation of the literature
    r = margins.reach[block if len(margins.reach) > 1 else 0]
    gamma = np.float32(margins.discount)
    if gamma == np.float32(1.0):
        for j in range(len(out)):
            v = ahead[j] if ahead[j] > r[j] else r[j]
            out[j] = v if v < l[j] else l[j]
        return
    for j in range(len(out)):
        out[j] = _bound(margins, block, j, ahead[j])


@njit(**OPTIONS)
def _add_planes(values: Floats, corner: int, pattern: Integers, products: Floats, out: Floats) -> None:
    """Fill `out` (block size) with the weighted sum of the blocks around a step's end along the outer axes."""
    if len(products) == 1:
        out[:] = values[corner : corner + len(out)]
        return
    for c in range(0, len(products), 2):
        _add_two(values[corner + pattern[c] :], values[corner + pattern[c + 1] :], products[c : c + 2], out, c > 0)


@njit(**OPTIONS)
def _shift(given: Floats, out: Floats, weights: Floats, at: int, stride: int) -> None:
    """Fill `out` with the weighted sum of a block's nodes at distance `stride`, starting at node `at`."""
    for c in range(0, len(weights), 2):
        _add_two(given[at + c * stride :], given[at + (c + 1) * stride :], weights[c : c + 2], out, c > 0)


@njit(**OPTIONS)
def _add_two(one: Floats, two: Floats, weights: Floats, out: Floats, add: bool) -> None:
    """Write the weighted sum of two arrays to `out`, or add it if `add` is true."""
    w1, w2 = weights[0], weights[1]
    if add:
        for j in range(len(out)):
            out[j] += w1 * one[j] + w2 * two[j]
    else:
        for j in range(len(out)):
            out[j] = w1 * one[j] + w2 * two[j]


@njit(**_INLINE)
def _core(inner: Integers, axes: int, size: int) -> tuple[int, int]:
    """Return the range of a block that excludes the ghosts along its first `axes` axes."""
    begin, end = 0, size
    for i in range(axes):
        begin += inner[i, 0] * inner[i, 2]
        end -= inner[i, 0] * inner[i, 3]
    return begin, end


@njit(**OPTIONS)
def _fill_ghosts(block: Floats, inner: Integers) -> None:
    """Copy a block's edges, or the opposite ends along periodic axes, into its ghosts."""
    for i in range(len(inner)):
        stride, count, below, above = inner[i, 0], inner[i, 1], inner[i, 2], inner[i, 3]
        length = stride * (count + below + above)
        for start in range(0, len(block), length):
            for g in range(below + above):
                place = g if g < below else g + count
                source = place - below
                source = source % count if inner[i, 4] else min(max(source, 0), count - 1)
                to, at = start + place * stride, start + (source + below) * stride
                for j in range(stride):
                    block[to + j] = block[at + j]
