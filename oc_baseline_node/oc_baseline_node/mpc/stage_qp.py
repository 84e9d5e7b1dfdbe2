"""Quadratic programs of optimal control, solved by an interior-point method with Riccati recursions.

    min sum_k 1/2 z_k' H_k z_k + q_k' z_k,  z_k = (x_k, u_k),  x_{k+1} = A_k z_k + b_k,  lower <= z <= upper,
    G_k z_k + c_k >= 0

Mehrotra's predictor-corrector method (Nocedal and Wright, Numerical Optimization, 16.6), with the recursion of Rao,
Wright and Rawlings (Application of interior-point methods to model predictive control, 1998). The computation time is
linear in the number of stages.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
_MOST_ITERATIONS = 40
_RESIDUAL = 1e-7
"""Tolerance of the equations, relative to their initial residual."""
_SHORT, _MOST_SHORT = 1e-2, 3
"""Step length that counts as none, and the number of such steps in a row that means too small initial slacks."""
_TO_EDGE = 0.995
_LEAST_PIVOT = 1e-12


@njit(cache=True, error_model="numpy")
def solve_stages(
    H: Array,
    q: Array,
    A: Array,
    b: Array,
    lower: Array,
    upper: Array,
    G: Array,
    c: Array,
    first: Array,
    damping: float,
    complementarity: float,
    least_slack: float,
    first_barrier: float,
) -> tuple[int, Array, Array, Array]:
    """Return iterations, z (K+1, w), multipliers of G z + c >= 0 (K+1, r), cost-to-go gradients by x (K+1, n).

    The number of iterations is 0 if the method makes no progress from the initial slacks (or no z satisfies the
    inequalities), and -1 if there is no minimum, because H is indefinite.

    Args:
        H: Hessians (K+1, w, w).
        q: Gradients (K+1, w).
        A: Dynamics (K, n, w); the states come first in z.
        b: Offsets of the dynamics (K, n).
        lower: Lower bounds of z (K+1, w); -inf if free.
        upper: Upper bounds of z (K+1, w); inf if free.
        G: Rows (K+1, r, w).
        c: Offsets of the rows (K+1, r); inf for an unused row.
        first: Given leading components of x_0 (f,); the others are free.
        damping: Value to add to the diagonal of H.
        complementarity: Mean product of slack and multiplier at convergence.
        least_slack: Initial minimum slack.
        first_barrier: Initial product of slack and multiplier.
    """
    K, n, w = A.shape
    r = G.shape[1]
    z = np.zeros((K + 1, w))
    # Lower bounds, upper bounds, rows.
    count = 2 * w + r
    slack, weight = np.ones((K + 1, count)), np.zeros((K + 1, count))
    used = np.zeros((K + 1, count), dtype=np.bool_)
    total = 0
    for k in range(K + 1):
        for i in range(count):
            value = -lower[k, i] if i < w else (upper[k, i - w] if i < 2 * w else c[k, i - 2 * w])
            if np.isfinite(value):
                used[k, i] = True
                total += 1
                slack[k, i] = max(value, least_slack)
                weight[k, i] = first_barrier / slack[k, i]
    corrected, new = np.zeros((K + 1, count)), np.zeros((K + 1, w))
    P, p = np.zeros((K + 1, n, n)), np.zeros((K + 1, n))
    F, f = np.zeros((K, w - n, n)), np.zeros((K, w - n))
    d_slack, d_weight = np.zeros((K + 1, count)), np.zeros((K + 1, count))
    left, barrier, short = 1.0, first_barrier, 0
    for iteration in range(1, _MOST_ITERATIONS + 1):
        target = 0.0
        for corrector in range(2):
            if not _riccati(H, q, A, b, lower, upper, G, c, first, damping, slack, weight, used, corrected, target,
                            new, P, p, F, f):  # fmt: skip
                return -1, z, weight[:, 2 * w :], p
            step = _directions(new, lower, upper, G, c, slack, weight, used, corrected, target, d_slack, d_weight)
            if corrector == 1 or total == 0:
                break
            after = 0.0
            for k in range(K + 1):
                for i in range(count):
                    if used[k, i]:
                        after += (slack[k, i] + step * d_slack[k, i]) * (weight[k, i] + step * d_weight[k, i])
                        corrected[k, i] = d_slack[k, i] * d_weight[k, i]
            target = barrier * min(1.0, (after / total / barrier) ** 3)
        step = min(1.0, _TO_EDGE * step)
        barrier = 0.0
        for k in range(K + 1):
            for i in range(w):
                z[k, i] += step * (new[k, i] - z[k, i])
            for i in range(count):
                if used[k, i]:
                    slack[k, i] += step * d_slack[k, i]
                    weight[k, i] += step * d_weight[k, i]
                    barrier += slack[k, i] * weight[k, i] / total
                corrected[k, i] = 0.0
        left *= 1.0 - step
        short = short + 1 if step < _SHORT else 0
        if short == _MOST_SHORT or not np.isfinite(barrier):
            break
        if barrier <= complementarity and left <= _RESIDUAL:
            gradients = np.empty((K + 1, n))
            for k in range(K + 1):
                for i in range(n):
                    gradients[k, i] = p[k, i]
                    for j in range(n):
                        gradients[k, i] += P[k, i, j] * z[k, j]
            return iteration, z, weight[:, 2 * w :], gradients
    return 0, z, weight[:, 2 * w :], p


@njit(cache=True, error_model="numpy")
def _directions(
    new: Array,
    lower: Array,
    upper: Array,
    G: Array,
    c: Array,
    slack: Array,
    weight: Array,
    used: Array,
    corrected: Array,
    target: float,
    d_slack: Array,
    d_weight: Array,
) -> float:
    """Fill in the steps of slacks and multipliers towards z `new`; return the step length that keeps them positive."""
    stages, w = new.shape
    step = 1.0
    for k in range(stages):
        for i in range(slack.shape[1]):
            if not used[k, i]:
                continue
            if i < w:
                at = new[k, i] - lower[k, i]
            elif i < 2 * w:
                at = upper[k, i - w] - new[k, i - w]
            else:
                at = c[k, i - 2 * w]
                for j in range(w):
                    at += G[k, i - 2 * w, j] * new[k, j]
            s, m = slack[k, i], weight[k, i]
            d_slack[k, i] = at - s
            d_weight[k, i] = (target - corrected[k, i] - m * d_slack[k, i]) / s - m
            if d_slack[k, i] < 0.0:
                step = min(step, -s / d_slack[k, i])
            if d_weight[k, i] < 0.0:
                step = min(step, -m / d_weight[k, i])
    return step


@njit(cache=True, error_model="numpy")
def _riccati(
    H: Array,
    q: Array,
    A: Array,
    b: Array,
    lower: Array,
    upper: Array,
    G: Array,
    c: Array,
    first: Array,
    damping: float,
    slack: Array,
    weight: Array,
    used: Array,
    corrected: Array,
    target: float,
    new: Array,
    P: Array,
    p: Array,
    F: Array,
    f: Array,
) -> bool:
    """Fill in z `new`, the minimum with barrier terms; return False if H is indefinite."""
    K, n, w = A.shape
    m = w - n
    M, v, T, t = np.empty((w, w)), np.empty(w), np.empty((n, w)), np.empty(n)
    for k in range(K, -1, -1):
        for i in range(w):
            v[i] = q[k, i]
            for j in range(w):
                M[i, j] = H[k, i, j]
            M[i, i] += damping
            if used[k, i]:
                ratio = weight[k, i] / slack[k, i]
                M[i, i] += ratio
                v[i] -= (target - corrected[k, i]) / slack[k, i] + weight[k, i] + ratio * lower[k, i]
            if used[k, w + i]:
                ratio = weight[k, w + i] / slack[k, w + i]
                M[i, i] += ratio
                v[i] += (target - corrected[k, w + i]) / slack[k, w + i] + weight[k, w + i] - ratio * upper[k, i]
        for row in range(G.shape[1]):
            at = 2 * w + row
            if used[k, at]:
                ratio = weight[k, at] / slack[k, at]
                pull = (target - corrected[k, at]) / slack[k, at] + weight[k, at] - ratio * c[k, row]
                for i in range(w):
                    if G[k, row, i] != 0.0:
                        v[i] -= pull * G[k, row, i]
                        for j in range(w):
                            M[i, j] += ratio * G[k, row, i] * G[k, row, j]
        if k == K:
            for i in range(n):
                p[k, i] = v[i]
                for j in range(n):
                    P[k, i, j] = M[i, j]
            continue
        for i in range(n):
            t[i] = p[k + 1, i]
            for j in range(n):
                t[i] += P[k + 1, i, j] * b[k, j]
            for j in range(w):
                total = 0.0
                for other in range(n):
                    total += P[k + 1, i, other] * A[k, other, j]
                T[i, j] = total
        for i in range(w):
            for other in range(n):
                if A[k, other, i] != 0.0:
                    v[i] += A[k, other, i] * t[other]
                    for j in range(w):
                        M[i, j] += A[k, other, i] * T[other, j]
        # Eliminate the controls, last first, by Gaussian elimination; the pivots show whether there is a minimum.
        for e in range(w - 1, n - 1, -1):
            pivot = M[e, e]
            if not pivot > _LEAST_PIVOT:
                return False
            for i in range(e):
                ratio = M[e, i] / pivot
                v[i] -= ratio * v[e]
                for j in range(e):
                    M[i, j] -= ratio * M[e, j]
        for i in range(n):
            p[k, i] = v[i]
            for j in range(n):
                P[k, i, j] = 0.5 * (M[i, j] + M[j, i])
        # The remainder of row e expresses its control by the states and the preceding controls.
        for e in range(m):
            row = n + e
            f[k, e] = -v[row] / M[row, row]
            for j in range(n):
                F[k, e, j] = -M[row, j] / M[row, row]
            for other in range(e):
                ratio = -M[row, n + other] / M[row, row]
                f[k, e] += ratio * f[k, other]
                for j in range(n):
                    F[k, e, j] += ratio * F[k, other, j]
    given = first.shape[0]
    for i in range(given):
        new[0, i] = first[i]
    for i in range(given, n):  # at most one: the time step
        pull = p[0, i]
        for j in range(given):
            pull += P[0, i, j] * new[0, j]
        if not P[0, i, i] > _LEAST_PIVOT:
            return False
        new[0, i] = -pull / P[0, i, i]
    for k in range(K):
        for e in range(m):
            new[k, n + e] = f[k, e]
            for j in range(n):
                new[k, n + e] += F[k, e, j] * new[k, j]
        for i in range(n):
            new[k + 1, i] = b[k, i]
            for j in range(w):
                new[k + 1, i] += A[k, i, j] * new[k, j]
    return True
