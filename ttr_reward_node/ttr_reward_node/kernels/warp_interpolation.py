"""Interpolation at the end of a step from a node with NVIDIA Warp, on a GPU or the CPU.

The rules are those of `kernels.row_interpolation` (nodes of a row alike) and `kernels.node_sweep` (each node has its
own steps). Corners are not stored: neighbouring threads work on the same slab, so recomputing them costs less than
reading a table.
"""

# No `from __future__ import annotations`: Warp needs annotations as objects. In Warp, `int(0)` declares a variable, `0`
# a constant.
# ruff: noqa: RUF046, UP018
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import warp as wp

from ttr_reward_node.kernels.stencil import PER_CELL

_BITS = wp.constant(11)  # PER_CELL = 2 ** _BITS
_MASK, _CELL = wp.constant(PER_CELL - 1), wp.constant(1.0 / PER_CELL)
HALF = wp.constant(PER_CELL // 2)
_LEAST_PART = wp.constant(3)  # distance to a plane of the grid below which no curvature is added [1 / PER_CELL cells]
_ALL = wp.constant(0.99)  # weight of the start node above which a step leads nowhere
_EVERY = wp.constant(0.9999)  # weight of the reachable corners above which all count as reachable
_CELL_AXES = 3  # if each node has its own steps: interpolate over the cell up to this many axes, above over a simplex


@wp.struct
class Table:
    """Steps of each slab under each pair, as in `kernels.stencil.StepTable`."""

    codes: wp.array2d[wp.uint16]
    ends: wp.array3d[wp.int16]
    ranges: wp.array4d[wp.int8]
    is_long: wp.array[wp.uint8]
    discounts: wp.array[wp.float32]


@wp.struct
class Rule:
    """Settings of one pass.

    Attributes:
        jump, enough, quiet, curved: As in `kernels.sweep.SweepSettings`, the times multiplied by the rate.
        first: 1 in the first phase, in which unreachable corners count as w = 0, else 0.
        near: 1 for a pass over the near nodes only, 0 for one over the others.
        full: 1 to try all pairs, 0 to try only the best of the last full pass.
        controls: Number of controls; the control is the fastest-varying index of the pairs.
        inner: Number of nodes in a slab.
        number: Number of the pass, from 1; slabs with even and odd index sums alternate.
        slot: Index at which to store the largest change.
    """

    jump: float
    enough: float
    quiet: float
    curved: int
    first: int
    near: int
    full: int
    controls: int
    inner: int
    number: int
    slot: int


class Interpolation(NamedTuple):
    """Types and device functions for one number of axes.

    Attributes:
        shape: Struct of the axes: counts, strides and periodic, n integers each.
        place_type: Struct of the cell in which a step ends.
        index_of: Returns the index of a node along each axis.
        place: Returns the cell in which a node's step ends.
        look: Returns w at the end of a step.
    """

    shape: Callable[..., Any]
    place_type: Any
    index_of: Callable[..., Any]
    place: Callable[..., Any]
    look: Callable[..., Any]


@wp.func
def _curvature(v0: float, v1: float, v2: float, v3: float) -> float:
    a = v0 - v1 - v1 + v2
    b = v1 - v2 - v2 + v3
    smaller = wp.where(wp.abs(a) < wp.abs(b), a, b)
    return wp.where(a * b > 0.0 and v0 > 0.0 and v3 > 0.0, smaller, 0.0)


@wp.func
def wrapped(i: int, count: int) -> int:
    """Wrap index i on a periodic axis of `count` nodes."""
    return ((i % count) + count) % count


@cache
def interpolation(n: int, n_outer: int) -> Interpolation:
    """Return the functions for n axes, the first n_outer of which are outer axes."""
    rows = n_outer < n
    simplex = not rows and n > _CELL_AXES
    rounded = 2 if rows else 3  # rounding error of a step truncated at the edge [1 / PER_CELL cells]
    vector = wp.types.vector(length=n, dtype=wp.int32)

    @wp.struct
    class Shape:
        counts: vector
        strides: vector
        periodic: vector

    @wp.struct
    class Place:
        """Cell in which a step ends: lower node, fractions above it, and offsets to the upper nodes."""

        inside: int
        base: int
        lower: vector
        part: vector
        ahead: vector

    @wp.func
    def index_of(node: int, shape: Shape) -> vector:
        index = vector()
        rest = int(node)
        for k in range(n):
            index[k] = rest // shape.strides[k]
            rest -= index[k] * shape.strides[k]
        return index

    @wp.func
    def place(table: Table, shape: Shape, index: vector, slab: int, p: int) -> Place:
        lowers = vector()
        parts = vector()
        aheads = vector()
        inside = int(1)
        base = int(0)
        for k in range(n):
            move = int(table.ends[slab, p, k])
            count = shape.counts[k]
            lower = int(index[k] + (move >> _BITS))
            part = int(move & _MASK)
            ahead = int(shape.strides[k])
            if shape.periodic[k] == 1:
                lower = wrapped(lower, count)
                if lower == count - 1:
                    ahead = -lower * shape.strides[k]
            else:
                if k < n_outer:
                    if lower == -1 and part >= PER_CELL - rounded:
                        lower = 0
                        part = 0
                    if lower == count - 1 and part <= rounded:
                        part = 0
                else:
                    low = int(table.ranges[slab, p, k - n_outer, 0])
                    high = int(table.ranges[slab, p, k - n_outer, 1])
                    if index[k] + low < 0 or index[k] + high >= count:
                        inside = 0
                if lower < 0 or lower + wp.where(part > 0, 1, 0) >= count:
                    inside = 0
            lowers[k] = lower
            parts[k] = part
            aheads[k] = ahead
            base += lower * shape.strides[k]
        return Place(inside, base, lowers, parts, aheads)

    @wp.func
    def bend(values: wp.array[float], at: Place, shape: Shape) -> float:
        nearest = int(at.base)
        total = float(0.0)
        for k in range(n):
            nearest += wp.where(at.part[k] >= HALF, at.ahead[k], 0)
        for k in range(n):
            lower = at.lower[k]
            part = at.part[k]
            count = shape.counts[k]
            stride = shape.strides[k]
            fits = shape.periodic[k] == 1 or (lower >= 1 and lower + 2 < count)
            if part >= _LEAST_PART and part <= PER_CELL - _LEAST_PART and fits:
                line = nearest - wp.where(part >= HALF, at.ahead[k], 0) - lower * stride
                v0 = values[line + wrapped(lower - 1, count) * stride]
                v1 = values[line + lower * stride]
                v2 = values[line + (lower + 1) % count * stride]
                v3 = values[line + (lower + 2) % count * stride]
                upper = float(part) * _CELL
                total -= 0.5 * upper * (1.0 - upper) * _curvature(v0, v1, v2, v3)
        return total

    @wp.func
    def look(
        values: wp.array[float], at: Place, shape: Shape, node: int, rule: Rule, is_long: bool, past: bool
    ) -> wp.vec2:
        """Return w at the end of a step, and the weight of the start node, which is excluded from the corners."""
        own = float(0.0)
        total = float(0.0)
        reachable = float(0.0)
        low = float(1.0)
        high = float(0.0)
        between = int(0)
        outer = int(1)
        inner = int(1)
        for k in range(n_outer):
            if at.part[k] > 0:
                between |= 1 << k
                outer = wp.where(simplex, outer + 1, 2 * outer)
        for k in range(n_outer, n):
            if at.part[k] > 0:
                between |= 1 << k
                inner *= 2
        outer_mask = between & ((1 << n_outer) - 1)
        inner_mask = between >> n_outer
        a = int(0)
        a_offset = int(at.base)
        before = int(PER_CELL)
        for _a_turn in range(outer):
            a_weight = float(1.0)
            if wp.static(simplex):
                # Move along one axis after another, in descending order of the end's distance.
                axis = int(-1)
                farthest = int(0)
                for k in range(n):
                    if (a >> k) & 1 == 0 and at.part[k] > farthest:
                        axis = k
                        farthest = at.part[k]
                a_weight = float(before - farthest) * _CELL
                before = farthest
            else:
                a_offset = at.base
                for k in range(n_outer):
                    upper = float(at.part[k]) * _CELL
                    a_weight *= wp.where((a >> k) & 1 == 1, upper, 1.0 - upper)
                    a_offset += wp.where((a >> k) & 1 == 1, at.ahead[k], 0)
            b = int(0)
            for _b_turn in range(inner):
                weight = float(a_weight)
                offset = int(a_offset)
                for k in range(n_outer, n):
                    upper = float(at.part[k]) * _CELL
                    weight *= wp.where((b >> (k - n_outer)) & 1 == 1, upper, 1.0 - upper)
                    offset += wp.where((b >> (k - n_outer)) & 1 == 1, at.ahead[k], 0)
                b = (b - inner_mask) & inner_mask  # the next subset of the bits
                if offset == node:
                    own = weight
                else:
                    v = values[offset]
                    counts = v > 0.0 and not (past and v == 1.0)
                    if counts:
                        total += weight * v
                        reachable += weight
                    if counts or not past:
                        low = wp.min(low, v)
                        high = wp.max(high, v)
            if wp.static(simplex):
                for k in range(n):
                    if k == axis:
                        a |= 1 << k
                        a_offset += at.ahead[k]
            else:
                a = (a - outer_mask) & outer_mask
        if own > _ALL:
            return wp.vec2(0.0, own)
        left = 1.0 - own
        total /= left
        reachable /= left
        found = float(0.0)
        smooth = high - low <= rule.jump * high and wp.where(past, reachable > _EVERY and rows, low > 0.0)
        if rule.first == 1:
            found = total
        elif smooth:
            found = total
            if rule.curved == 1:
                found += bend(values, at, shape) / left
        elif not is_long and reachable > 0.0 and (past or reachable >= rule.enough):
            found = total / reachable
        return wp.vec2(found, own)

    return Interpolation(Shape, Place, index_of, place, look)
