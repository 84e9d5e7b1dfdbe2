"""One sweep of the semi-Lagrangian scheme over all nodes, in place, compiled once for all systems.

The values are w = exp(-lambda phi), Kruzhkov's transform v = 1 - w seen from the other end: 1 in the target, exactly 0 where
nothing leads to it, and as precise in single precision at large times as at small ones.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

FREE, NEAR, FIXED = 0, 1, 2
PLAIN, BLOCKED, PAST = 0.0, -1.0, -2.0
"""Flags of nodes: plain; within a step of target or obstacle; value known."""

_INLINE = {"error_model": "numpy", "forceinline": True}


@njit(**_INLINE)
def _wrap(index: int, count: int) -> int:
    if index >= count:
        return index - count
    if index < 0:
        return index + count
    return index


@njit(cache=True, error_model="numpy")
def build_stencil(
    moves, index, n_outer, counts, periodic, strides, slab_offset, cell_shift, weight
):
    """Corners and weights of the point where one step from a slab ends.

    Fills slab_offset (c,), cell_shift (c, n_inner) and weight (c,) and returns the number of corners; 0 outside the grid.
    """
    n = counts.size
    corners = 1
    slab_offset[0] = 0
    weight[0] = 1.0
    for k in range(n):
        position = moves[k] + (index[k] if k < n_outer else 0)
        lower = int(np.floor(position))
        upper_weight = position - lower
        if k < n_outer:
            if periodic[k]:
                lower = lower % counts[k]
            else:
                if lower == counts[k] - 1 and upper_weight < 1e-3:
                    upper_weight = 0.0
                if lower == -1 and upper_weight > 1.0 - 1e-3:
                    lower, upper_weight = 0, 0.0
                if lower < 0 or lower + (1 if upper_weight > 0.0 else 0) > counts[k] - 1:
                    return 0
            upper = _wrap(lower + 1, counts[k])
            for c in range(corners):
                if upper_weight > 0.0:
                    slab_offset[corners + c] = slab_offset[c] + upper * strides[k]
                    weight[corners + c] = weight[c] * upper_weight
                slab_offset[c] += lower * strides[k]
                weight[c] *= 1.0 - upper_weight
            if upper_weight > 0.0:
                corners *= 2
        else:
            j = k - n_outer
            for c in range(corners):
                if upper_weight > 0.0:
                    slab_offset[corners + c] = slab_offset[c]
                    weight[corners + c] = weight[c] * upper_weight
                    for i in range(j):
                        cell_shift[corners + c, i] = cell_shift[c, i]
                    cell_shift[corners + c, j] = lower + 1
                cell_shift[c, j] = lower
                weight[c] *= 1.0 - upper_weight
            if upper_weight > 0.0:
                corners *= 2
    return corners


@njit(cache=True, error_model="numpy")
def build_curves(moves, index, n_outer, counts, periodic, strides, curve_slab, curve_shift, curve_weight):
    """Four collinear corners around the end of the step along each axis on which it ends between nodes."""
    n = counts.size
    curves = 0
    for k in range(n):
        position = moves[k] + (index[k] if k < n_outer else 0)
        lower = int(np.floor(position))
        g = position - lower
        if g < 1e-3 or g > 1 - 1e-3:
            continue
        if k < n_outer and not periodic[k] and (lower - 1 < 0 or lower + 2 > counts[k] - 1):
            continue
        curve_weight[curves] = g
        for i in range(4):
            curve_slab[curves, i] = 0
            for m in range(n):
                at = int(np.floor(moves[m] + (index[m] if m < n_outer else 0) + 0.5))
                if m == k:
                    at = lower - 1 + i
                if m < n_outer:
                    if periodic[m]:
                        at = at % counts[m]
                    else:
                        at = min(max(at, 0), counts[m] - 1)
                    curve_slab[curves, i] += at * strides[m]
                else:
                    curve_shift[curves, i, m - n_outer] = at
        curves += 1
    return curves


@njit(**_INLINE)
def _clearance_at(clearance, first, second):
    """Bilinear interpolation of the clearance (count, count) at a position in cells, inside the grid."""
    i = min(max(int(np.floor(first)), 0), clearance.shape[0] - 1)
    j = min(max(int(np.floor(second)), 0), clearance.shape[1] - 1)
    a, b = first - i, second - j
    i1, j1 = min(i + 1, clearance.shape[0] - 1), min(j + 1, clearance.shape[1] - 1)
    low = clearance[i, j] * (1 - b) + clearance[i, j1] * b
    high = clearance[i1, j] * (1 - b) + clearance[i1, j1] * b
    return low * (1 - a) + high * a


@njit(**_INLINE)
def _entry(start, moves, part, box, disc, disc_axes, counts, periodic):
    """Fraction of the chord start + [move0, move1] at which it enters the target; 2 if it does not."""
    enter, leave = 0.0, 1.0
    for k in range(counts.size):
        low, high = box[k, 0], box[k, 1]
        if high - low == np.inf:
            continue
        before = moves[0, k] if part == 1 else 0.0
        a = start[k]
        if periodic[k]:
            middle = 0.5 * (low + high)
            a -= np.round((a + before - middle) / counts[k]) * counts[k]
        a += before
        b = moves[part, k] - before
        if b == 0.0:
            if a < low - 1e-9 or a > high + 1e-9:
                return 2.0
        else:
            t0, t1 = (low - a) / b, (high - a) / b
            if t0 > t1:
                t0, t1 = t1, t0
            enter, leave = max(enter, t0), min(leave, t1)
    if disc_axes[0] >= 0:
        i, j = disc_axes[0], disc_axes[1]
        # In metres: disc holds x, y of the centre relative to the first node, the radius and the spacings.
        before_i, before_j = (moves[0, i], moves[0, j]) if part == 1 else (0.0, 0.0)
        ax, ay = (start[i] + before_i) * disc[3] - disc[0], (start[j] + before_j) * disc[4] - disc[1]
        bx, by = (moves[part, i] - before_i) * disc[3], (moves[part, j] - before_j) * disc[4]
        aa, ab, bb = ax * ax + ay * ay - disc[2] * disc[2], ax * bx + ay * by, bx * bx + by * by
        if bb == 0.0:
            if aa > 0.0:
                return 2.0
        else:
            root = ab * ab - aa * bb
            if root < 0.0:
                return 2.0
            root = np.sqrt(root)
            enter, leave = max(enter, (-ab - root) / bb), min(leave, (-ab + root) / bb)
    return enter if enter <= leave else 2.0


@njit(cache=True, error_model="numpy")
def near_step(start, moves, box, disc, disc_axes, counts, periodic, clearance, clearance_axes):
    """A step near target or obstacles: fraction of its duration until the target, 2 if it misses, -1 if it is blocked."""
    i, j = clearance_axes[0], clearance_axes[1]
    t = _entry(start, moves, 0, box, disc, disc_axes, counts, periodic)
    if t <= 1.0:
        return 0.5 * t
    if i >= 0 and _clearance_at(clearance, start[i] + moves[0, i], start[j] + moves[0, j]) <= 0.0:
        return -1.0
    t = _entry(start, moves, 1, box, disc, disc_axes, counts, periodic)
    if t <= 1.0:
        return 0.5 + 0.5 * t
    if i >= 0 and _clearance_at(clearance, start[i] + moves[1, i], start[j] + moves[1, j]) <= 0.0:
        return -1.0
    return 2.0


@njit(cache=True, error_model="numpy")
def near_outcomes(
    flags, counts, periodic, n_outer, durations, moves, rate, n_controls, box, disc, disc_axes, clearance, clearance_axes,
    outcomes,
):
    """What becomes of each step from each node near the target or an obstacle.

    Fills outcomes (near nodes, pairs): the value of w at the target where the step, or a second one, hits it; else one of
    the codes below.
    """
    n = counts.size
    slabs, pairs = durations.shape
    inner_size = flags.size // slabs
    index = np.zeros(n)
    end = np.zeros(n)
    near = 0
    for node in range(flags.size):
        if flags[node] != NEAR:
            continue
        rest = node
        for k in range(n - 1, -1, -1):
            index[k] = rest % counts[k]
            rest //= counts[k]
        slab = node // inner_size
        for p in range(pairs):
            outcomes[near, p] = PLAIN
            if durations[slab, p] == 0.0:
                continue
            t = near_step(index, moves[slab, p], box, disc, disc_axes, counts, periodic, clearance, clearance_axes)
            if t < 0.0:
                outcomes[near, p] = BLOCKED
                continue
            if t <= 1.0:
                outcomes[near, p] = np.exp(-rate * t * durations[slab, p])
                continue
            touches = disc_axes[0] < 0
            for k in range(n):
                end[k] = index[k] + moves[slab, p, 1, k]
                if box[k, 1] - box[k, 0] < np.inf:
                    at = end[k]
                    if periodic[k]:
                        middle = 0.5 * (box[k, 0] + box[k, 1])
                        at -= np.round((at - middle) / counts[k]) * counts[k]
                    touches &= box[k, 0] - 1.0 < at and at < box[k, 1] + 1.0
            if not touches:
                continue
            # It ends in a cell that the target's edge may cut: a second step tells when it gets there.
            second = 0
            stride = 1
            for k in range(n_outer - 1, -1, -1):
                i = int(np.round(end[k]))
                i = i % counts[k] if periodic[k] else min(max(i, 0), counts[k] - 1)
                second += i * stride
                stride *= counts[k]
            worst = 2.0
            for d in range(pairs // n_controls):
                best = 0.0
                for q in range(d * n_controls, (d + 1) * n_controls):
                    if durations[second, q] == 0.0:
                        continue
                    t = near_step(end, moves[second, q], box, disc, disc_axes, counts, periodic, clearance, clearance_axes)
                    if 0.0 <= t and t <= 1.0:
                        best = max(best, np.exp(-rate * t * durations[second, q]))
                worst = min(worst, best)
            outcomes[near, p] = np.exp(-rate * durations[slab, p]) * worst if worst > 0.0 else PAST
        near += 1


@njit(cache=True, error_model="numpy")
def sweep(
    values, flags, counts, periodic, n_outer, durations, moves, rate, n_controls, bits, order,
    outcomes, row_near, jump, kink,
):
    """Update every node once.

    Args:
        values: w, flat, layout order, float32, changed in place.
        flags: uint8, flat.
        counts, periodic: (n,), layout order; the last axis is inner.
        bits: bit k says that axis k is swept downwards, where the motion does not decide.

    Returns:
        The largest change of phi [s], inf where a node has become reachable or unreachable.
    """
    n = counts.size
    n_inner = n - n_outer
    slabs, pairs = durations.shape
    strides = np.empty(n, np.int64)
    stride = 1
    for k in range(n - 1, -1, -1):
        strides[k] = stride
        stride *= counts[k]
    inner_size = values.size // slabs
    last = counts[n - 1]
    rows = inner_size // last
    most = 1 << n
    index = np.zeros(n, np.int64)
    start = np.zeros(n)
    slab_offset = np.zeros((pairs, most), np.int64)
    cell_shift = np.zeros((pairs, most, n_inner), np.int64)
    weight = np.zeros((pairs, most))
    base = np.zeros((pairs, most), np.int64)
    corners = np.zeros(pairs, np.int64)
    curves = np.zeros(pairs, np.int64)
    curve_slab = np.zeros((pairs, n, 4), np.int64)
    curve_shift = np.zeros((pairs, n, 4, n_inner), np.int64)
    curve_weight = np.zeros((pairs, n))
    curve_base = np.zeros((pairs, n, 4), np.int64)
    curve_g = np.zeros((pairs, n))
    curve_weight_row = np.zeros((pairs, n))
    row_curves = np.zeros(pairs, np.int64)
    curve_first = np.zeros(pairs, np.int64)
    curve_last = np.zeros(pairs, np.int64)
    discount = np.zeros(pairs)
    row_corners = np.zeros(pairs, np.int64)
    first_ok = np.zeros(pairs, np.int64)
    last_ok = np.zeros(pairs, np.int64)
    down = np.zeros(n_inner, np.bool_)
    n_disturbances = pairs // n_controls
    largest = 0.0
    last_periodic = periodic[n - 1]
    for turn in range(slabs):
        rest = turn
        slab = 0
        for k in range(n_outer - 1, -1, -1):
            i = rest % counts[k]
            rest //= counts[k]
            index[k] = counts[k] - 1 - i if (bits >> k) & 1 else i
            start[k] = index[k]
            slab += index[k] * strides[k]
        slab //= inner_size
        for p in range(pairs):
            discount[p] = np.exp(-rate * durations[slab, p])
            if durations[slab, p] > 0.0:
                corners[p] = build_stencil(
                    moves[slab, p, 1], index, n_outer, counts, periodic, strides, slab_offset[p], cell_shift[p], weight[p]
                )
            else:
                corners[p] = 0
            curves[p] = 0
            if corners[p] > 0 and order == 2:
                curves[p] = build_curves(
                    moves[slab, p, 1], index, n_outer, counts, periodic, strides, curve_slab[p], curve_shift[p], curve_weight[p]
                )
            lowest, highest = 0, 0
            for c in range(curves[p]):
                for i in range(4):
                    s = curve_shift[p, c, i, n_inner - 1]
                    lowest, highest = min(lowest, s), max(highest, s)
            curve_first[p], curve_last[p] = -lowest, last - 1 - highest
            lowest, highest = 0, 0
            for c in range(corners[p]):
                s = cell_shift[p, c, n_inner - 1]
                if c == 0:
                    lowest, highest = s, s
                lowest, highest = min(lowest, s), max(highest, s)
            first_ok[p], last_ok[p] = -lowest, last - 1 - highest
        for j in range(n_inner):
            forward, backward = False, False
            for p in range(pairs):
                if corners[p] > 0:
                    move = moves[slab, p, 1, n_outer + j]
                    forward |= move > 1e-4
                    backward |= move < -1e-4
            if forward and not backward:
                down[j] = True
            elif backward and not forward:
                down[j] = False
            else:
                down[j] = (bits >> (n_outer + j)) & 1
        for row_turn in range(rows):
            rest = row_turn
            row_offset = slab * inner_size
            for j in range(n_inner - 2, -1, -1):
                k = n_outer + j
                i = rest % counts[k]
                rest //= counts[k]
                index[k] = counts[k] - 1 - i if down[j] else i
                start[k] = index[k]
                row_offset += index[k] * strides[k]
            for p in range(pairs):
                row_corners[p] = corners[p]
                for c in range(corners[p]):
                    offset = slab_offset[p, c] + cell_shift[p, c, n_inner - 1]
                    for j in range(n_inner - 1):
                        k = n_outer + j
                        i = index[k] + cell_shift[p, c, j]
                        if periodic[k]:
                            i = _wrap(i, counts[k])
                        elif i < 0 or i >= counts[k]:
                            row_corners[p] = 0
                            break
                        offset += i * strides[k]
                    base[p, c] = offset
                row_curves[p] = 0
                for q in range(curves[p]):
                    fits = True
                    for i in range(4):
                        offset = curve_slab[p, q, i] + curve_shift[p, q, i, n_inner - 1]
                        for j in range(n_inner - 1):
                            k = n_outer + j
                            at = index[k] + curve_shift[p, q, i, j]
                            if periodic[k]:
                                at = _wrap(at, counts[k])
                            elif at < 0 or at >= counts[k]:
                                fits = False
                            offset += at * strides[k]
                        curve_base[p, row_curves[p], i] = offset
                    curve_weight_row[p, row_curves[p]] = -0.5 * curve_weight[p, q] * (1.0 - curve_weight[p, q])
                    curve_g[p, row_curves[p]] = curve_weight[p, q]
                    if fits:
                        row_curves[p] += 1
            row = row_offset // last
            near, step = (row_near[row + 1], -1) if down[n_inner - 1] else (row_near[row] - 1, 1)
            for turn_in_row in range(last):
                j = last - 1 - turn_in_row if down[n_inner - 1] else turn_in_row
                node = row_offset + j
                flag = flags[node]
                if flag == FIXED:
                    continue
                if flag == NEAR:
                    near += step
                worst = 2.0
                for d in range(n_disturbances):
                    best = 0.0
                    for p in range(d * n_controls, (d + 1) * n_controls):
                        outcome = PLAIN
                        if flag == NEAR:
                            outcome = outcomes[near, p]
                            if outcome == BLOCKED:
                                continue
                            if outcome > 0.0:
                                best = max(best, outcome)
                                continue
                        if row_corners[p] == 0:
                            continue
                        total, finite = 0.0, 0.0
                        vmin, vmax = 2.0, 0.0
                        if first_ok[p] <= j and j <= last_ok[p]:
                            for c in range(row_corners[p]):
                                v = values[base[p, c] + j]
                                if outcome == PAST and v == 1.0:
                                    v = np.float32(0.0)
                                total += weight[p, c] * v
                                finite += weight[p, c] if v > 0.0 else 0.0
                                vmax = max(vmax, v)
                                vmin = min(vmin, v if v > 0.0 else 2.0)
                        elif last_periodic:
                            for c in range(row_corners[p]):
                                s = cell_shift[p, c, n_inner - 1]
                                v = values[base[p, c] - s + _wrap(j + s, last)]
                                total += weight[p, c] * v
                                finite += weight[p, c] if v > 0.0 else 0.0
                                vmax = max(vmax, v)
                                vmin = min(vmin, v if v > 0.0 else 2.0)
                        else:
                            continue
                        if finite < 0.5 and (outcome != PAST or finite == 0.0):
                            continue
                        if vmax - vmin > jump * rate * vmax and first_ok[p] <= j and j <= last_ok[p] and outcome == PLAIN:
                            middle = 0.5 * (vmax + vmin)
                            t_hi, w_hi, t_lo, w_lo = 0.0, 0.0, 0.0, 0.0
                            for c in range(row_corners[p]):
                                v = values[base[p, c] + j]
                                if v > middle:
                                    t_hi += weight[p, c] * v
                                    w_hi += weight[p, c]
                                elif v > 0.0:
                                    t_lo += weight[p, c] * v
                                    w_lo += weight[p, c]
                            total = t_hi / w_hi if w_hi >= w_lo else t_lo / w_lo
                        elif finite < 0.999999:
                            total /= finite
                        elif curve_first[p] <= j and j <= curve_last[p]:
                            for q in range(row_curves[p]):
                                v0 = values[curve_base[p, q, 0] + j]
                                v1 = values[curve_base[p, q, 1] + j]
                                v2 = values[curve_base[p, q, 2] + j]
                                v3 = values[curve_base[p, q, 3] + j]
                                if v0 > 0.0 and v3 > 0.0:
                                    a, b = v0 - 2.0 * v1 + v2, v1 - 2.0 * v2 + v3
                                    if kink > 0.0 and a < 0.0 and b < 0.0 and -(a + b) > kink * max(abs(v1 - v0), abs(v3 - v2)):
                                        g = curve_g[p, q]
                                        total += min(v1 + g * (v1 - v0), v2 - (1 - g) * (v3 - v2)) - (v1 + g * (v2 - v1))
                                        continue
                                    if a > 0.0 and b > 0.0:
                                        total += curve_weight_row[p, q] * min(a, b)
                                    elif a < 0.0 and b < 0.0:
                                        total += curve_weight_row[p, q] * max(a, b)
                        best = max(best, discount[p] * total)
                    worst = min(worst, best)
                old = values[node]
                new = np.float32(worst)
                if new != old:
                    values[node] = new
                    if old == 0.0 or new == 0.0:
                        largest = np.inf
                    else:
                        largest = max(largest, abs(new - old) / max(new, old))
    return largest / rate
