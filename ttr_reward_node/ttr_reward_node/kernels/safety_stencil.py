"""Compiled steps of the safety solver, and interpolation between the nodes around their ends."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Integers = NDArray[np.int64]

OPTIONS = {"error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz", "arcp"}}
_INLINE = {**OPTIONS, "forceinline": True}


class SafetyTables(NamedTuple):
    """Steps of all blocks under each pair of control and disturbance, axes in the layout's order.

    Attributes:
        blocks: Offset of each block in the array of values (blocks,).
        corners: Offset of the first node of a step's stencil along the outer axes (blocks, pairs).
        cells: Displacement of a step along the inner axes, rounded down [cells] (blocks, pairs, n_inner).
        parts: Distance of the step's end from the node below, as a fraction of a cell (blocks, pairs, n).
        pattern: Offsets of the nodes of a stencil from its first one, along the outer axes; without inner axes, along
            all but the last axis.
        inner: Stride, nodes, ghosts below, ghosts above, and 1 if periodic, of each inner axis (n_inner, 5).
        disturbances: Number of disturbances; the disturbance is the fastest-varying index of the pairs.
        width: Nodes of a stencil along each axis: 4 for cubic interpolation, 2 for linear.
    """

    blocks: Integers
    corners: Integers
    cells: Integers
    parts: Floats
    pattern: Integers
    inner: Integers
    disturbances: int
    width: int


@njit(**_INLINE)
def cubic_weights(part: np.float32) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Return the weights of Lagrange interpolation between the middle two of four nodes."""
    one, two, half, sixth = np.float32(1.0), np.float32(2.0), np.float32(0.5), np.float32(1.0 / 6.0)
    p, q = part, one - part
    outside, inside = -p * q * sixth, half * (one + p) * (two - p)
    return outside * (two - p), inside * q, inside * p, outside * (one + p)


@njit(**_INLINE)
def cubic_products(parts: Floats, b: int, p: int, axes: int, products: Floats) -> int:
    """Fill in the weights of a cubic stencil along the first `axes` axes, and return their number."""
    products[0], size = np.float32(1.0), 1
    for k in range(axes):
        w0, w1, w2, w3 = cubic_weights(parts[b, p, k])
        for c in range(size - 1, -1, -1):
            product = products[c]
            products[4 * c], products[4 * c + 1] = product * w0, product * w1
            products[4 * c + 2], products[4 * c + 3] = product * w2, product * w3
        size *= 4
    return size


@njit(**_INLINE)
def linear_products(parts: Floats, b: int, p: int, axes: int, products: Floats) -> int:
    """Fill in the weights of a linear stencil, as `cubic_products` does for a cubic one."""
    products[0], size = np.float32(1.0), 1
    for k in range(axes):
        part = parts[b, p, k]
        for c in range(size - 1, -1, -1):
            product = products[c]
            products[2 * c], products[2 * c + 1] = product * (np.float32(1.0) - part), product * part
        size *= 2
    return size


@njit(**_INLINE)
def cubic_at(values: Floats, tables: SafetyTables, b: int, p: int, products: Floats) -> np.float32:
    """Interpolate at the end of a step. The four sums along the last axis are vectorised."""
    corners, parts, pattern = tables.corners, tables.parts, tables.pattern
    last = parts.shape[2] - 1
    size, corner = cubic_products(parts, b, p, last, products), corners[b, p]
    s0 = s1 = s2 = s3 = np.float32(0.0)
    for c in range(size):
        at, w = corner + pattern[c], products[c]
        s0 += w * values[at]
        s1 += w * values[at + 1]
        s2 += w * values[at + 2]
        s3 += w * values[at + 3]
    w0, w1, w2, w3 = cubic_weights(parts[b, p, last])
    return w0 * s0 + w1 * s1 + w2 * s2 + w3 * s3


@njit(**_INLINE)
def linear_at(values: Floats, tables: SafetyTables, b: int, p: int, products: Floats) -> np.float32:
    """Interpolate at the end of a step with a linear stencil, as `cubic_at` does with a cubic one."""
    corners, parts, pattern = tables.corners, tables.parts, tables.pattern
    last = parts.shape[2] - 1
    size, corner = linear_products(parts, b, p, last, products), corners[b, p]
    s0 = s1 = np.float32(0.0)
    for c in range(size):
        at, w = corner + pattern[c], products[c]
        s0 += w * values[at]
        s1 += w * values[at + 1]
    part = parts[b, p, last]
    return (np.float32(1.0) - part) * s0 + part * s1
