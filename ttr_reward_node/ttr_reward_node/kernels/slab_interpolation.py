"""Compiled interpolation at the ends of the steps from all nodes of a slab, by the rule of `row_interpolation`.

All loops over the nodes are branch-free so that the compiler vectorises them. Special cases, such as unreachable
corners, are computed for all nodes and selected afterwards.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ttr_reward_node.kernels.row_interpolation import Part, Rule
from ttr_reward_node.kernels.slab_stencil import LEAST_PART, SlabStencil, fill_mask
from ttr_reward_node.kernels.stencil import PER_CELL, Floats, Grid

_OPTIONS = {"error_model": "numpy", "fastmath": {"contract"}}
_INLINE = {**_OPTIONS, "forceinline": True}
_CELL = np.float32(1.0 / PER_CELL)
_WHOLE = np.float32(0.9999)  # weight of the reachable corners above which all count as reachable


class SlabBuffers(NamedTuple):
    """Scratch memory for one slab, each array (nodes of a slab,).

    Attributes:
        total: Weighted sum of w.
        reach: Weight of the reachable corners.
        low, high: Smallest and largest w of the reachable corners.
        mask: 1 if the step stays on the grid, else 0.
        bend: Curvature.
    """

    total: Floats
    reach: Floats
    low: Floats
    high: Floats
    mask: Floats
    bend: Floats


@njit(**_OPTIONS)
def interpolate_slab(
    values: Floats,
    grid: Grid,
    offset: int,
    own: Part,
    stencil: SlabStencil,
    rule: Rule,
    work: SlabBuffers,
    smooth: bool,
    out: Floats,
) -> None:
    """Fill `out` (nodes of a slab,) with the discounted w at the end of each step.

    Args:
        values: w at all nodes.
        grid: Axes.
        offset: First node of the slab in which the steps begin.
        own: Part of the grid being swept.
        stencil: Stencil of the slab.
        rule: Interpolation settings.
        work: Scratch memory.
        smooth: Whether every node of the slabs in the stencil is reachable.
        out: Output.
    """
    total, reach, low, high, mask, bend = work.total, work.reach, work.low, work.high, work.mask, work.bend
    size, discount = len(out), stencil.discount
    fill_mask(grid, stencil.begin, stencil.end, mask)
    if rule.jump == np.inf:
        _sum_corners(values, stencil, total)
    elif smooth:
        _sum_and_span(values, stencil, total, low, high)
        reach[:] = 1.0
    else:
        _sum_span_reach(values, stencil, total, reach, low, high)
    shift = 0
    for k in range(grid.n - 1, grid.n_outer - 1, -1):
        stride = grid.strides[k]
        shift += stencil.lower[k] * stride
        if stencil.part[k] > 0:
            upper = np.float32(stencil.part[k]) * _CELL
            _between(total, stride, upper)
            if rule.jump != np.inf:
                if not smooth:
                    _between(reach, stride, upper)
                _least(low, stride)
                _largest(high, stride)
    begin, end = max(0, -shift), min(size, size - shift)
    out[:begin] = 0.0
    out[end:] = 0.0
    m = end - begin
    at = begin + shift
    result, inside = out[begin:end], mask[begin:end]
    total, reach, low, high = total[at : at + m], reach[at : at + m], low[at : at + m], high[at : at + m]
    home, a = values[offset + begin : offset + end], stencil.own
    if rule.jump == np.inf:
        for j in range(m):
            result[j] = inside[j] * (discount * (total[j] - a * home[j]))
        return
    if rule.curved:
        _fill_bend(values, grid, own, stencil, work)
    curve = bend[begin:end]
    share, jump, enough = np.float32(1.0) - a, rule.jump, rule.enough
    curved = np.float32(1.0) if rule.curved else np.float32(0.0)
    long = np.float32(1.0) if stencil.long else np.float32(0.0)
    for j in range(m):
        there = (reach[j] - (a if home[j] > 0.0 else np.float32(0.0))) / share
        odd = (high[j] - low[j] > jump * high[j]) | (there < _WHOLE)
        known = total[j] - a * home[j]
        clear = known + (curve[j] if curved > 0.0 else np.float32(0.0))
        edge = known / there if (long == 0.0) & (there > 0.0) & (there >= enough) else np.float32(0.0)
        result[j] = inside[j] * discount * (edge if odd else clear)


@njit(**_INLINE)
def _sum_corners(values: Floats, stencil: SlabStencil, total: Floats) -> None:
    size = len(total)
    for c in range(stencil.size):
        at, weight = stencil.corner[c], stencil.weight[c]
        line = values[at : at + size]
        if c == 0:
            for j in range(size):
                total[j] = weight * line[j]
        else:
            for j in range(size):
                total[j] += weight * line[j]


@njit(**_INLINE)
def _sum_and_span(values: Floats, stencil: SlabStencil, total: Floats, low: Floats, high: Floats) -> None:
    size = len(total)
    for c in range(stencil.size):
        at, weight = stencil.corner[c], stencil.weight[c]
        line = values[at : at + size]
        if c == 0:
            for j in range(size):
                v = line[j]
                total[j], low[j], high[j] = weight * v, v, v
        else:
            for j in range(size):
                v = line[j]
                total[j] += weight * v
                low[j] = v if v < low[j] else low[j]
                high[j] = v if v > high[j] else high[j]


@njit(**_INLINE)
def _sum_span_reach(
    values: Floats, stencil: SlabStencil, total: Floats, reach: Floats, low: Floats, high: Floats
) -> None:
    size = len(total)
    total[:], reach[:], low[:], high[:] = 0.0, 0.0, 1.0, 0.0
    for c in range(stencil.size):
        at, weight = stencil.corner[c], stencil.weight[c]
        line = values[at : at + size]
        for j in range(size):
            v = line[j]
            least = v if v > 0.0 else np.float32(1.0)
            total[j] += weight * v
            reach[j] += weight if v > 0.0 else np.float32(0.0)
            low[j] = least if least < low[j] else low[j]
            high[j] = v if v > high[j] else high[j]


@njit(**_INLINE)
def _between(line: Floats, stride: int, upper: np.float32) -> None:
    """Interpolate in place between each node and the one `stride` ahead; the last `stride` nodes are left unchanged."""
    lower = np.float32(1.0) - upper
    m = len(line) - stride
    ahead = line[stride:]
    for j in range(m):
        line[j] = lower * line[j] + upper * ahead[j]


@njit(**_INLINE)
def _least(line: Floats, stride: int) -> None:
    m, ahead = len(line) - stride, line[stride:]
    for j in range(m):
        line[j] = ahead[j] if ahead[j] < line[j] else line[j]


@njit(**_INLINE)
def _largest(line: Floats, stride: int) -> None:
    m, ahead = len(line) - stride, line[stride:]
    for j in range(m):
        line[j] = ahead[j] if ahead[j] > line[j] else line[j]


@njit(**_OPTIONS)
def _fill_bend(values: Floats, grid: Grid, own: Part, stencil: SlabStencil, work: SlabBuffers) -> None:
    """Fill in the curvature omitted by linear interpolation, at the nearest nodes of the other axes."""
    bend = work.bend
    size = len(bend)
    bend[:] = 0.0
    slab, shift = np.int64(0), np.int64(0)
    for k in range(grid.n):
        if k < grid.n_outer:
            slab += (stencil.lower[k] + _ahead(grid, stencil, k)) * grid.strides[k]
        else:
            shift += (stencil.lower[k] + _ahead(grid, stencil, k)) * grid.strides[k]
    for k in range(grid.n):
        part, lower, stride, count = stencil.part[k], stencil.lower[k], grid.strides[k], grid.counts[k]
        if part < LEAST_PART or part > PER_CELL - LEAST_PART:
            continue
        upper = np.float32(part) * _CELL
        weight = np.float32(-0.5) * upper * (np.float32(1.0) - upper)
        near = (lower + _ahead(grid, stencil, k)) * stride
        if k < grid.n_outer:
            if not grid.periodic[k] and (lower < 1 or lower + 2 >= count):
                continue
            at0 = _owned(slab - near + (lower - 1) % count * stride, own) + shift
            at1 = _owned(slab - near + lower * stride, own) + shift
            at2 = _owned(slab - near + (lower + 1) % count * stride, own) + shift
            at3 = _owned(slab - near + (lower + 2) % count * stride, own) + shift
            low, high = max(0, -shift), min(size, size - shift)
            _add_curve(values, at0, at1, at2, at3, low, high, weight, bend)
        else:
            first = shift - near + (lower - 1) * stride
            low, high = max(0, -first), min(size, size - first - 3 * stride)
            begin, end = max(1 - lower, 0), count - max(lower + 2, 0)
            at0 = _owned(slab, own) + first
            for block in range(0, size, stride * count):  # index k varies slowest in a block
                a, b = max(low, block + begin * stride), min(high, block + end * stride)
                if a < b:
                    _add_curve(values, at0, at0 + stride, at0 + 2 * stride, at0 + 3 * stride, a, b, weight, bend)


@njit(**_INLINE)
def _add_curve(
    values: Floats, at0: int, at1: int, at2: int, at3: int, low: int, high: int, weight: np.float32, bend: Floats
) -> None:
    m = high - low
    line0, line1 = values[at0 + low : at0 + high], values[at1 + low : at1 + high]
    line2, line3 = values[at2 + low : at2 + high], values[at3 + low : at3 + high]
    out = bend[low:high]
    for j in range(m):
        out[j] += weight * _curvature(line0[j], line1[j], line2[j], line3[j])


@njit(**_INLINE)
def _curvature(v0: np.float32, v1: np.float32, v2: np.float32, v3: np.float32) -> np.float32:
    """Return `row_interpolation.curvature`, computed without branches."""
    a, b = v0 - v1 - v1 + v2, v1 - v2 - v2 + v3
    smaller = a if abs(a) < abs(b) else b
    return smaller if (a * b > 0.0) & (v0 > 0.0) & (v3 > 0.0) else np.float32(0.0)


@njit(**_INLINE)
def _ahead(grid: Grid, stencil: SlabStencil, k: int) -> np.int64:
    """Return the cells from the lower to the nearest node along axis k: 0 or 1, with wrap-around."""
    if 2 * stencil.part[k] < PER_CELL:
        return np.int64(0)
    return np.int64(1) if k >= grid.n_outer or stencil.lower[k] + 1 < grid.counts[k] else -stencil.lower[k]


@njit(**_INLINE)
def _owned(offset: np.int64, own: Part) -> np.int64:
    """Return where to read a slab: in place, or in the copy if another thread owns it."""
    return offset if own.begin <= offset < own.end else offset + own.copy
