"""One pass of the semi-Lagrangian scheme over all nodes at once with NVIDIA Warp, on a GPU or, for tests, the CPU.

The update is that of `kernels.sweep` and `kernels.node_sweep`. A pass reads one buffer and writes another, so its
result does not depend on the order of the threads. Each pass updates only every other slab: two neighbours that read
each other would swap their values for ever.
"""

# No `from __future__ import annotations`: Warp needs annotations as objects. In Warp, `int(0)` declares a variable, `0`
# a constant.
# ruff: noqa: RUF046, UP018
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import warp as wp

from ttr_reward_node.kernels.boundary_conditions import BLOCKED, FIXED, LOST, NEAR, PASSES_TARGET
from ttr_reward_node.kernels.warp_interpolation import HALF, Rule, Table, interpolation, wrapped

_TINY = wp.constant(1e-30)
_STAYS, _NEAR = wp.constant(FIXED | LOST), wp.constant(NEAR)
_BLOCKED, _PASSES_TARGET = wp.constant(BLOCKED), wp.constant(PASSES_TARGET)


class SweepKernels(NamedTuple):
    """Kernels for one number of axes.

    Attributes:
        shape: Struct of the axes: counts, strides and periodic, n integers each.
        sweep: Updates the nodes.
        awaken: Selects the slabs that need an update; requires inner axes.
    """

    shape: Callable[..., Any]
    sweep: Callable[..., Any]
    awaken: Callable[..., Any]


@wp.func
def _change(old: float, new: float, first: int) -> float:
    if first == 1:
        return wp.abs(new - old)
    if wp.min(old, new) <= 0.0:
        return wp.inf
    return wp.abs(new - old) / wp.max(old, new)


@cache
def sweep_kernels(n: int, n_outer: int) -> SweepKernels:
    """Return the kernels for n axes, the first n_outer of which are outer axes; compiled at their first launch."""
    rows = n_outer < n
    Shape, Place, index_of, place, look = interpolation(n, n_outer)

    @wp.kernel(enable_backward=False, module="unique")
    def sweep(
        values: wp.array[float],
        news: wp.array[float],
        flags: wp.array[wp.uint8],
        near_nodes: wp.array[int],
        outcomes: wp.array2d[float],
        table: Table,
        shape: Shape,
        rule: Rule,
        choices: wp.array[wp.uint16],
        active: wp.array[wp.uint8],
        changed: wp.array[int],
        changes: wp.array[float],
    ):
        i = wp.tid()
        node = int(i)
        if rule.near == 1:
            node = near_nodes[i]
        flag = int(flags[node])
        old = values[node]
        if rule.near == 0 and (flag & _NEAR) != 0:
            return
        news[node] = old
        slab = node // rule.inner
        if (flag & _STAYS) != 0 or (wp.static(rows) and active[slab] == wp.uint8(0)):
            return
        index = index_of(node, shape)
        if wp.static(not rows):
            turn = int(rule.number)
            for k in range(n):
                turn += index[k]
            if turn % 2 == 1:
                return
        worst = float(1.0)
        best = float(0.0)
        choice = int(0)
        first = int(0)
        until = int(table.codes.shape[1])
        if rule.full == 0:
            first = int(choices[node])
            until = first + 1
        for p in range(first, until):
            code = int(table.codes[slab, p])
            outcome = float(0.0)
            if rule.near == 1:
                outcome = outcomes[i, p]
            if code != 0 and outcome != _BLOCKED:
                found = outcome
                if outcome <= 0.0:
                    found = 0.0
                    at = place(table, shape, index, slab, p)
                    if at.inside == 1:
                        past = outcome == _PASSES_TARGET
                        seen = look(values, at, shape, node, rule, table.is_long[p] == wp.uint8(1), past)
                        discount = table.discounts[code]
                        found = seen[0] * discount * (1.0 - seen[1]) / (1.0 - discount * seen[1])
                if found > best:
                    best = found
                    choice = p
            if (p + 1) % rule.controls == 0 or rule.full == 0:
                worst = wp.min(worst, best)
                best = 0.0
        if rule.full == 1:
            choices[node] = wp.uint16(choice)
        new = worst
        if new < _TINY:
            new = 0.0
        # A pass over the best pairs only, or in a monotone or curved phase, never lowers w, except to 0 by all pairs.
        only_grows = rule.full == 0 or rule.curved == 1 or rule.first == 1
        if new == old or (new < old and only_grows and (new > 0.0 or rule.full == 0)):
            return
        news[node] = new
        change = _change(old, new, rule.first)
        if change > changes[rule.slot]:
            wp.atomic_max(changes, rule.slot, change)
        if wp.static(rows) and change > rule.quiet:
            changed[slab] = rule.number

    @wp.func
    def changed_at(changed: wp.array[int], offset: int, inner: int, last: int) -> bool:
        slab = offset // inner
        return offset >= 0 and slab < len(changed) and changed[slab] >= last

    @wp.func
    def looks_at_news(at: Place, shape: Shape, changed: wp.array[int], rule: Rule, last: int) -> bool:
        """Whether a slab with a corner or a curve of a step has changed since pass number `last`."""
        base = int(0)
        mask = int(0)
        size = int(1)
        for k in range(n_outer):
            base += at.lower[k] * shape.strides[k]
            if at.part[k] > 0:
                mask |= 1 << k
                size *= 2
        fresh = bool(False)
        a = int(0)
        for _turn in range(size):
            offset = int(base)
            for k in range(n_outer):
                offset += wp.where((a >> k) & 1 == 1, at.ahead[k], 0)
            a = (a - mask) & mask
            fresh = fresh or changed_at(changed, offset, rule.inner, last)
        if rule.curved == 1:
            nearest = int(base)
            for k in range(n_outer):
                nearest += wp.where(at.part[k] >= HALF, at.ahead[k], 0)
            for k in range(n_outer):
                line = nearest - wp.where(at.part[k] >= HALF, at.ahead[k], 0) - at.lower[k] * shape.strides[k]
                for step in range(2):
                    beyond = at.lower[k] - 1 + 3 * step
                    if shape.periodic[k] == 1:
                        beyond = wrapped(beyond, shape.counts[k])
                    fresh = fresh or changed_at(changed, line + beyond * shape.strides[k], rule.inner, last)
        return fresh

    @wp.kernel(enable_backward=False, module="unique")
    def awaken(
        table: Table,
        shape: Shape,
        rule: Rule,
        changed: wp.array[int],
        seen: wp.array[int],
        active: wp.array[wp.uint8],
    ):
        slab = wp.tid()
        index = index_of(slab * rule.inner, shape)
        turn = int(rule.number)
        last = seen[slab]
        for k in range(n_outer):
            turn += index[k]
        active[slab] = wp.uint8(0)
        if wp.static(n_outer > 0) and turn % 2 == 1:
            return
        fresh = bool(last == 0)
        pairs = table.codes.shape[1]
        for p in range(pairs):
            if not fresh and table.codes[slab, p] != wp.uint16(0):
                fresh = looks_at_news(place(table, shape, index, slab, p), shape, changed, rule, last)
        if fresh:
            active[slab] = wp.uint8(1)
            if rule.full == 1:
                seen[slab] = rule.number

    return SweepKernels(Shape, sweep, awaken)
