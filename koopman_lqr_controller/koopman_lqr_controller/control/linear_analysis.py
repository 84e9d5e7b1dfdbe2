"""Linear analysis of a model: poles, controllability, variances and costs (thesis 4.3.3). NumPy only."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.models.edmd import LinearModel

Poles = NDArray[np.complex128]


def poles(A: Array) -> Poles:
    """Return the eigenvalues of A (n,), by decreasing modulus."""
    found = np.linalg.eigvals(A).astype(np.complex128)
    return found[np.lexsort((-found.imag, -found.real, -np.abs(found)))]


def distances_to_nearest(wanted: Poles, found: Poles) -> Array:
    """Return the distance from each given pole to the nearest computed one (wanted,)."""
    return np.asarray(np.abs(wanted[:, None] - found[None, :]).min(axis=1), dtype=np.float64)


def jacobian(f: Callable[[Array], Array], x: Array, step: float = 1e-5) -> Array:
    """Return df/dx (outputs, inputs) by central differences.

    Args:
        f: Vectorised function from (N, inputs) to (N, outputs).
        x: Point of the derivative (inputs,).
        step: Step size to either side.
    """
    moves = step * np.eye(len(x))
    return np.asarray((f(x + moves) - f(x - moves)).T / (2.0 * step), dtype=np.float64)


def linearise(step: Callable[[Array, Array], Array], x: Array, u: Array, size: float = 1e-5) -> LinearModel:
    """Return A (n, n) and B (n, m) of a system x_{k+1} = step(x_k, u_k) around (x, u), by central differences.

    Args:
        step: Function from one state (n,) and control (m,) to the next state.
        x: State to linearise at (n,).
        u: Control to linearise at (m,).
        size: Size of the differences.
    """

    def moved(both: Array) -> Array:
        return np.array([step(row[: len(x)], row[len(x) :]) for row in both])

    both = jacobian(moved, np.concatenate((x, u)), size)
    return LinearModel(np.ascontiguousarray(both[:, : len(x)]), np.ascontiguousarray(both[:, len(x) :]))


def controllability_values(model: LinearModel) -> Array:
    """Return the singular values of [B, A B, ..., A^(n-1) B] (n,), relative to the largest one.

    If A is unstable, it is divided by its spectral radius: the columns span the same space, and the last ones do not
    dominate.
    """
    A = model.A / max(1.0, float(np.abs(np.linalg.eigvals(model.A)).max()))
    blocks = [model.B]
    for _ in range(len(A) - 1):
        blocks.append(A @ blocks[-1])
    values = np.linalg.svd(np.hstack(blocks), compute_uv=False)
    return values / max(float(values[0]), np.finfo(float).tiny)


def ranks(values: Array, tolerances: Sequence[float]) -> list[int]:
    """Return the number of relative singular values above each tolerance."""
    return [int(np.count_nonzero(values > tolerance)) for tolerance in tolerances]


def pbh_distances(model: LinearModel) -> Array:
    """Return the controllability of each mode, in the order of `poles` (n,), by the Popov-Belevitch-Hautus test.

    The measure is the smallest singular value of [p I - A, B] over the largest of [A, B]; 0 for an uncontrollable mode.
    """
    scale = np.linalg.norm(np.hstack((model.A, model.B)), 2)
    unit = np.eye(len(model.A))
    each = [np.linalg.svd(np.hstack((p * unit - model.A, model.B)), compute_uv=False)[-1] for p in poles(model.A)]
    return np.array(each) / scale


def participation_ratio(variances: Array) -> float:
    """Return (sum s)^2 / sum s^2 of variances, the effective number of directions, from 1 to n."""
    return float(variances.sum() ** 2 / max(float(np.sum(variances**2)), np.finfo(float).tiny))


def variances(z: Array) -> Array:
    """Return the variances of samples (N, n) along their principal directions (at most n,), largest first."""
    values = np.linalg.svd(z - z.mean(axis=0), compute_uv=False)
    return np.asarray(values**2 / len(z), dtype=np.float64)


def components_for(variances: Array, share: float) -> int:
    """Return the number of variances, largest first, that make up a given fraction of their sum."""
    held = np.cumsum(variances) / max(float(variances.sum()), np.finfo(float).tiny)
    return int(np.searchsorted(held, share - 1e-12) + 1)


def costs_of(model: LinearModel, K: Array, P: Array) -> tuple[Array, Array]:
    """Return the Q (n, n) and R (m, m) for which the infinite-horizon regulator has gain K and cost-to-go P.

    This inverts the Riccati equation: Q = P - A^T P (A - B K), and R K = B^T P (A - B K); R is unique if the rows of K
    are independent.
    """
    closed = model.A - model.B @ K
    Q = P - model.A.T @ P @ closed
    R = model.B.T @ P @ closed @ np.linalg.pinv(K)
    return 0.5 * (Q + Q.T), 0.5 * (R + R.T)


def observation_cost(jacobians: Array, Q: Array) -> Array:
    """Return E[J^T Q J] (k, k), the latent cost z^T Q z as a cost of observations around the given ones.

    Args:
        jacobians: dz/dx at each of some observations (N, n, k).
        Q: Diagonal of the state cost (n,).
    """
    return np.asarray(np.einsum("tia,i,tib->ab", jacobians, Q, jacobians) / len(jacobians), dtype=np.float64)


def patch_costs(encode: Callable[[Array], Array], image: Array, Q: Array, size: int, fill: float) -> Array:
    """Return the cost dz^T Q dz of hiding each patch of an image (rows, columns), with dz the resulting change of z.

    Used for images, where Jacobian rows of single pixels are uninformative and too numerous.

    Args:
        encode: Function from images (N, channels, height, width) to z (N, n).
        image: (channels, height, width).
        Q: Diagonal of the state cost (n,).
        size: Rows and columns of a patch; incomplete patches at the borders are ignored.
        fill: Value of the pixels of a hidden patch.
    """
    rows, columns = (length // size for length in image.shape[1:])
    hidden = np.repeat(image[None], rows * columns, axis=0)
    for index in range(rows * columns):
        top, left = (size * part for part in divmod(index, columns))
        hidden[index, :, top : top + size, left : left + size] = fill
    change = encode(hidden) - encode(image[None])
    return np.asarray((change**2 @ Q).reshape(rows, columns), dtype=np.float64)
