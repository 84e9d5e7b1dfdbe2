"""Compiled semi-Lagrangian sweep for grids with short rows: whole slabs are updated at once.

The update is that of `kernels.sweep`. In six dimensions a row has one or two dozen nodes, too few to pay for its
stencils; a slab has hundreds of nodes, and all of them take the same steps.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ttr_reward_node.kernels.boundary_conditions import BLOCKED, FIXED, LOST, NEAR, PASSES_TARGET
from ttr_reward_node.kernels.row_interpolation import Rule, find_part, place_turn
from ttr_reward_node.kernels.slab_interpolation import SlabBuffers, interpolate_slab
from ttr_reward_node.kernels.slab_stencil import SLAB_STENCIL, SlabStencil, place_slab
from ttr_reward_node.kernels.stencil import PER_CELL, Floats, Grid, Integers, StepTable
from ttr_reward_node.kernels.sweep import TINY, Nodes, SweepSettings, change_of

_OPTIONS = {"error_model": "numpy"}
_CELL = np.float32(1.0 / PER_CELL)


class SlabHistory(NamedTuple):
    """Times of the slabs' updates and changes: a slab is updated again only if a slab in its stencils has changed.

    Attributes:
        changed, seen: Last change and last update of each slab (slabs,), in ticks of its part's clock; 0 for none.
        clocks: Number of updates and changes so far in each part (parts,).
        changed_in: Last sweep in which each slab changed (slabs,); with two parts, followed by a copy from before the
            sweep.
        reachable: Number of reachable nodes in each slab, followed by a copy likewise.
        open: Number of nodes in each slab that a sweep may change (slabs,).
    """

    changed: Integers
    seen: Integers
    clocks: Integers
    changed_in: NDArray[np.int32]
    reachable: NDArray[np.int32]
    open: NDArray[np.int32]


@njit(**_OPTIONS)
def sweep_slabs(
    nodes: Nodes, grid: Grid, steps: StepTable, history: SlabHistory, settings: SweepSettings, part: int, parts: int
) -> tuple[np.float32, int]:
    """Update every slab of a part with a changed slab in its stencils; arguments and results as in `sweep.sweep`."""
    bits = settings.bits
    slabs, pairs = steps.codes.shape
    values = nodes.values
    size = len(nodes.flags) // slabs
    index = np.zeros(grid.n, np.int64)
    stencils = np.zeros(pairs, SLAB_STENCIL)
    for p in range(pairs):
        stencils[p].long = steps.long[p]
    found = np.zeros((pairs, size), np.float32)
    work = SlabBuffers(
        np.zeros(size, np.float32),
        np.zeros(size, np.float32),
        np.zeros(size, np.float32),
        np.zeros(size, np.float32),
        np.zeros(size, np.float32),
        np.zeros(size, np.float32),
    )
    quiet = np.float32(settings.quiet * settings.rate)
    rule = Rule(np.float32(settings.jump * settings.rate), np.float32(settings.enough), settings.curved)
    grow = settings.curved or settings.jump == np.inf
    changed, seen, clocks, changed_in, reachable, open_ = history
    first, until, own = find_part(grid, slabs * size, part, parts)
    largest, done = np.float32(0.0), 0
    for turn in range((until - first) * grid.strides[0] // size):
        offset = place_turn(grid, grid.n_outer, turn, first, until, bits, index)
        here = offset // size
        if open_[here] == 0:
            continue
        fresh = seen[here] == 0
        for p in range(pairs):
            stencil = stencils[p]
            stencil.size = 0
            if steps.codes[here, p] == 0:
                continue
            discount = steps.discounts[steps.codes[here, p]]
            place_slab(grid, index, own, steps.ends[here, p], steps.ranges[here, p], discount, stencil)
            for c in range(stencil.size):
                at = stencil.corner[c] // size
                if at < slabs:
                    fresh |= changed[at] > seen[here]
                else:  # a copy: changes of the previous sweep are new here
                    fresh |= changed_in[at] == settings.number - 1
        if not fresh:
            continue
        done += 1
        clocks[part] += 1
        seen[here] = clocks[part]
        for p in range(pairs):
            stencil = stencils[p]
            least, most = np.int64(size), np.int64(0)
            for c in range(stencil.size):
                number = np.int64(reachable[stencil.corner[c] // size])
                least, most = min(least, number), max(most, number)
            if most == 0:
                found[p, :] = 0.0
            else:
                interpolate_slab(values, grid, offset, own, stencil, rule, work, least == size, found[p])
        _apply_outcomes(nodes, grid, offset, stencils, rule, found)
        change, there = _update(nodes, offset, found, steps.controls, grow, rule.jump, work)
        reachable[here] = there
        largest = max(largest, change)
        if change > quiet:
            clocks[part] += 1  # later than `seen`, so that a slab that reads itself is updated again
            changed[here] = clocks[part]
            changed_in[here] = settings.number
    return largest / settings.rate, done


@njit(**_OPTIONS)
def _apply_outcomes(nodes: Nodes, grid: Grid, offset: int, stencils: NDArray[Any], rule: Rule, found: Floats) -> None:
    """Apply the effects of target and obstacles to the steps from the near nodes of the slab at `offset`."""
    values, flags, outcomes, row_near = nodes
    pairs, size = found.shape
    last = grid.counts[grid.n - 1]
    near, until = row_near[offset // last], row_near[(offset + size) // last]
    if near == until:
        return
    for j in range(size):
        if not flags[offset + j] & NEAR:
            continue
        if not flags[offset + j] & LOST:
            for p in range(pairs):
                outcome = outcomes[near, p]
                if outcome > 0.0:
                    found[p, j] = outcome
                elif outcome == BLOCKED:
                    found[p, j] = 0.0
                elif outcome == PASSES_TARGET and stencils[p].size > 0:
                    found[p, j] = _past(values, grid, offset, j, stencils[p], rule)
        near += 1


@njit(**_OPTIONS)
def _past(values: Floats, grid: Grid, offset: int, j: int, stencil: SlabStencil, rule: Rule) -> np.float32:
    """Return the discounted w at the end of the step from node j of a slab, ignoring target nodes (w = 1).

    For steps that pass the target; `offset` is the slab's. 0 if the step leaves the grid.
    """
    rest, inner, shift, lines = j, 0, np.int64(0), 1
    for k in range(grid.n - 1, grid.n_outer - 1, -1):
        i = rest % grid.counts[k]
        rest //= grid.counts[k]
        if i < stencil.begin[k] or i >= stencil.end[k]:
            return np.float32(0.0)
        shift += stencil.lower[k] * grid.strides[k]
        lines *= 2 if stencil.part[k] > 0 else 1
    total, reachable, low, high = np.float32(0.0), np.float32(0.0), np.float32(1.0), np.float32(0.0)
    for c in range(stencil.size):
        for inner in range(lines):
            at, weight, rest = stencil.corner[c] + shift + j, stencil.weight[c], inner
            for k in range(grid.n_outer, grid.n):
                if stencil.part[k] > 0:
                    upper = np.float32(stencil.part[k]) * _CELL
                    at += (rest & 1) * grid.strides[k]
                    weight *= upper if rest & 1 else np.float32(1.0) - upper
                    rest >>= 1
            v = values[at]
            if v > 0.0 and v != 1.0 and at != offset + j:
                total += weight * v
                reachable += weight
                low, high = min(low, v), max(high, v)
    if rule.jump == np.inf:
        return stencil.discount * total
    share = reachable / (np.float32(1.0) - stencil.own)
    if share == 0.0 or (stencil.long and (high - low > rule.jump * high or share < 0.9999)):
        return np.float32(0.0)
    return stencil.discount * total / share


@njit(**_OPTIONS)
def _update(
    nodes: Nodes, offset: int, found: Floats, controls: int, grow: bool, jump: np.float32, work: SlabBuffers
) -> tuple[np.float32, int]:
    """Update the nodes of a slab; return the largest relative change and the number of reachable nodes."""
    pairs, size = found.shape
    news, best = work.total, work.reach
    news[:] = 1.0
    for group in range(0, pairs, controls):
        best[:] = 0.0
        for p in range(group, group + controls):
            line = found[p]
            for j in range(size):
                best[j] = line[j] if line[j] > best[j] else best[j]
        for j in range(size):
            news[j] = best[j] if best[j] < news[j] else news[j]
    largest, there = np.float32(0.0), 0
    values, flags = nodes.values[offset : offset + size], nodes.flags[offset : offset + size]
    for j in range(size):
        old, new = values[j], news[j]
        new = new if new >= TINY else np.float32(0.0)
        kept = (flags[j] & (FIXED | LOST)) != 0 or (grow and new < old and new > 0.0) or new == old
        if not kept:
            values[j] = new
            largest = max(largest, change_of(old, new, jump))
        there += 1 if values[j] > 0.0 else 0
    return largest, there
