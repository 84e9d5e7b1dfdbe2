"""Identifiability of z_{k+1} = A z_k + B u_k from recorded data: checks before any fit.

All checks use standardised columns, so that neither units nor offsets matter. The controls are assessed by their
residual after regression on the state and a constant (Frisch-Waugh-Lovell), because only this part identifies B
(Proctor, Brunton, Kutz 2016: A and B are distinguishable only if the controls are not a function of the state).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from koopman_lqr_controller.arrays import Array, check_size, real_array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.least_squares import EPS, Deviations, LeastSquares, compressed, sizes

_STILL = 1e-9
"""Ratio of a control's spread to its size below which it counts as constant: less than 7 of 16 digits remain."""
_ON_ITS_OWN = 1e-8
"""Independent fraction of a control below which B is only rounding, since no command or A is known to 8 digits."""
_WEAK = 0.1
"""Independent fraction of a control below which noise may replace it, so that the noise is checked."""
_KNOWN = 5.0
"""Required ratio of a weak control's effect to its standard error.

B is then wrong by a factor of 0.6 to 1.4 at two standard errors. An LQR stays stable with half of its gain, so a
regulator tolerates this."""
_DRIFT = 0.05
"""Fraction of A and B that a constant may change; smaller changes are within the error of a linear model anyway."""
_EXPLAINED = 0.1
"""Remaining fraction of the error if a constant explains it, as opposed to a nonlinearity."""
_NAMED = 6
"""Maximum number of columns named in a message; the rest is given as a count."""
_ROUNDED = 1e3
"""Number of rounding errors of the data that may add up."""


@dataclass(frozen=True)
class RegressionData:
    """Snapshots with validated shapes and values.

    Attributes:
        z: States (N, n).
        u: Controls (N, m).
        z_next: Next states (N, n).
        eps: Precision of the data: that of the coarsest type.
    """

    z: Array
    u: Array
    z_next: Array
    eps: float

    @classmethod
    def of(cls, z: ArrayLike, u: ArrayLike, z_next: ArrayLike) -> RegressionData:
        """Convert the data to float64.

        Raises:
            KoopmanError: The shapes are not (N, n), (N, m) and (N, n), there are no rows, or values are not finite.
        """
        arrays = {name: real_array(name, values) for name, values in (("z", z), ("u", u), ("z_next", z_next))}
        for name, array in arrays.items():
            if array.ndim != 2:
                raise KoopmanError(
                    f"{name} has shape {array.shape}: give a row for each snapshot, as in {name}[:, None]"
                )
        rows = {name: len(array) for name, array in arrays.items()}
        if len(set(rows.values())) > 1 or arrays["z"].shape != arrays["z_next"].shape:
            told = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
            raise KoopmanError(f"snapshots do not fit each other ({told}): give as many rows, and z_next as wide as z")
        if not arrays["z"].size:
            raise KoopmanError(f"snapshots are empty (z has shape {arrays['z'].shape}): record a drive first")
        for name, array in arrays.items():
            _check_finite(name, array)
            for column in array.T:
                check_size(name, column)
        return cls(arrays["z"], arrays["u"], arrays["z_next"], max(map(_precision, (z, u, z_next))))

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of states and of controls."""
        return self.z.shape[1], self.u.shape[1]

    def check_like(self, other: RegressionData) -> None:
        """Raise if the data have other numbers of states or controls than some other data.

        Raises:
            KoopmanError: Gives both shapes.
        """
        for name, mine, given in (("z", self.z, other.z), ("u", self.u, other.u)):
            if mine.shape != given.shape:
                raise KoopmanError(
                    f"{name} of the twin has shape {mine.shape}, must have {given.shape}, one row for each"
                )


def _precision(values: ArrayLike) -> float:
    """Return the relative rounding of an array: that of its type if coarser than float64."""
    kind = np.asarray(values).dtype
    return max(float(np.finfo(kind).eps), EPS) if kind.kind == "f" else EPS


def _check_finite(name: str, array: Array) -> None:
    bad = ~np.isfinite(array)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise KoopmanError(
            f"snapshots hold values that are not finite: {name}[{row}, {column}] is {array[row, column]}, one of "
            f"{np.count_nonzero(bad)}; leave such rows out"
        )


def check_controls_move(u: Array, names: Sequence[str] = ()) -> None:
    """Raise if controls (N, m) are constant or move together.

    Args:
        u: Recorded controls (N, m).
        names: Names of the controls in messages (m,); "control 0" etc. by default.

    Raises:
        KoopmanError: Names the controls, or a value that is not finite.
    """
    _check_finite("u", u)
    names = names or [f"control {index}" for index in range(u.shape[1])]
    largest = np.abs(u).max(axis=0, initial=0.0)
    around = Deviations.of(u)
    for index in map(int, np.flatnonzero(around.spread <= _STILL * largest)):
        raise KoopmanError(
            f"{names[index]} never moves (it is {u[0, index]:.4g} throughout), so its effect cannot be told from a "
            f"drift: excite all controls while recording, or leave it out"
        )
    if u.shape[1] > 1:
        _, own, directions = np.linalg.svd(around.values, full_matrices=len(u) < u.shape[1])
        if len(own) < u.shape[1] or own[-1] < max(_ON_ITS_OWN, _ROUNDED * around.rounding):
            raise KoopmanError(
                f"{_named(directions[-1], names)} move together, so their effects cannot be told apart: excite each "
                "control on its own while recording"
            )


def check_controls_told(data: RegressionData, lifted: bool) -> None:
    """Raise if B cannot be identified from the data, regardless of A.

    Args:
        data: Validated snapshots.
        lifted: Whether z consists of many nearly redundant functions, or noise: their residual is then not noise of the
            state, and counts only for controls with a small independent part.

    Raises:
        KoopmanError: Names the controls and the data to record.
    """
    N, m = data.u.shape
    if m == 0:
        return
    names = [f"control {index}" for index in range(m)]
    check_controls_move(data.u)
    z, u, y = (Deviations.of(it, data.eps) for it in (data.z, data.u, data.z_next))
    here, controls, there = compressed(z.values, u.values, y.values)
    span = _orthonormal(here)
    spare = N - span.shape[1] - m - 1
    if spare < 1:
        raise KoopmanError(
            f"{N} snapshots are too few for {span.shape[1]} independent observables and {m} controls: record at least "
            f"{N - spare + 1}, better ten times as many"
        )
    left = _without(controls, span)
    P, own, directions = np.linalg.svd(left, full_matrices=False)
    # A control's precision is relative to its size, including the offset, not to its spread.
    floor = max(_ON_ITS_OWN * u.rounding / data.eps, _ROUNDED * max(z.rounding, u.rounding))
    if own[-1] < floor:
        raise KoopmanError(
            f"{_named(directions[-1], names)}: a linear function of the state to {own[-1]:.0e}, as under feedback "
            "u = -K z, so A and B cannot be told apart: add a dither of its own to each control while recording"
        )
    missed = _without(_without(there, span), P)
    noise = np.maximum(np.sqrt(np.sum(missed**2, axis=0) * N / spare), y.rounding)
    for index in range(m):
        _check_beside_noise(index, here, controls, there * np.sqrt(N), noise, lifted)


def _check_beside_noise(index: int, z: Array, u: Array, z_next: Array, noise: Array, lifted: bool) -> None:
    """Raise if noise hides or could have caused the independent part of a control.

    All columns are standardised deviations, in any orthonormal coordinates of the rows.

    Args:
        index: Index of the control.
        z: States, of unit length (rows, n).
        u: Controls, of unit length (rows, m).
        z_next: Next states, scaled to unit spread (rows, n).
        noise: Fraction of each next state's spread not explained by a linear model (n,).
        lifted: As in `check_controls_told`.
    """
    others = np.hstack((z, np.delete(u, index, axis=1)))
    own = _without(u[:, index], _orthonormal(others))
    size = float(np.linalg.norm(own))
    effect = np.abs(own @ z_next) / (size * np.maximum(noise, np.finfo(float).tiny))
    # Noise of measured states looks like a dither of a control that follows them: K times the model's residual.
    feedback = np.linalg.lstsq(others, u[:, index], rcond=1e-10)[0][: len(noise)]
    alike = float(np.linalg.norm(feedback * noise))
    weak = size < _WEAK
    if (weak and effect.max() < _KNOWN) or (size < alike and (weak or not lifted)):
        raise KoopmanError(
            f"control {index}: all but {100 * size:.2g} % follows from the state and other controls, too little for B "
            "beside the noise: add a larger dither of its own to each control while recording, or record for longer"
        )


def check_rows(data: RegressionData) -> None:
    """Raise if there are not more rows than unknowns.

    Raises:
        KoopmanError: Gives the required number.
    """
    least = data.z.shape[1] + data.u.shape[1] + 2
    if len(data.z) < least:
        raise KoopmanError(
            f"{len(data.z)} snapshots are too few for {data.z.shape[1]} observables and {data.u.shape[1]} controls: "
            f"record at least {least}, better ten times as many"
        )


def check_states_told(data: RegressionData) -> None:
    """Raise if states are zero or linearly dependent, so that A is not unique.

    Raises:
        KoopmanError: Names the states.
    """
    names = [f"state {index}" for index in range(data.z.shape[1])]
    for index in map(int, np.flatnonzero(~data.z.any(axis=0))):
        raise KoopmanError(
            f"{names[index]} is 0 throughout, so nothing tells how it acts: excite it while recording, or leave it "
            "out; with lifted=True it is taken to act on nothing"
        )
    null = LeastSquares(data.z).null
    if null.shape[1]:
        raise KoopmanError(
            f"{_named(np.linalg.norm(null, axis=1), names)} repeat each other, so A is not unique: leave some out; "
            "with lifted=True, as for functions of a lifting, the smallest A is taken, which predicts as well"
        )


def check_no_drift(data: RegressionData, W: Array) -> None:
    """Raise if a constant explains the data much better, since A and B of a model without drift would be biased.

    Args:
        data: Validated snapshots.
        W: Least-squares coefficients without a constant (n + m, n).

    Raises:
        KoopmanError: Gives the reference to subtract.
    """
    X = np.hstack((data.z, data.u))
    with_constant = np.hstack((X, np.ones((len(X), 1))))
    problem = LeastSquares(with_constant)
    affine = problem.solve(data.z_next)
    missed = data.z_next - with_constant @ affine
    errors = problem.standard_errors(missed, data.eps * sizes(data.z_next))
    of, to = Deviations.of(X).spread[:, None], Deviations.of(data.z_next).spread
    unit = np.where(to > 0.0, to, np.inf)
    scale = of / unit
    bent, known = np.linalg.norm((affine[:-1] - W) * scale), np.linalg.norm(affine[:-1] * scale)
    finite = np.where(np.isfinite(errors[:-1]), errors[:-1], 0.0)
    left, without = (np.linalg.norm(it / unit) for it in (missed, data.z_next - X @ W))
    material = bent > _DRIFT * known or left < _EXPLAINED * without
    if material and bent > max(_KNOWN * float(np.linalg.norm(finite * scale)), _ON_ITS_OWN * float(known)):
        raise KoopmanError(
            f"z and u are not deviations from a fixed point: a constant changes A and B by {100 * bent / known:.2g} %; "
            "take one away first, as with Snapshots.centred, or give z the constant 1 as a state"
        )


def _orthonormal(values: Array) -> Array:
    """Return an orthonormal basis of the columns' span (N, rank)."""
    U, s, _ = np.linalg.svd(values, full_matrices=False)
    return np.asarray(U[:, s > 1e-12 * max(float(s.max(initial=0.0)), EPS)], dtype=np.float64)


def _without(values: Array, span: Array) -> Array:
    """Return the part of columns outside an orthonormal span; computed twice to reduce rounding."""
    for _ in range(2):
        values = values - span @ (span.T @ values)
    return values


def _named(weights: Array, names: Sequence[str]) -> str:
    """Return the names of the columns involved in a combination."""
    part = np.abs(weights)
    taking = [names[index] for index in map(int, np.flatnonzero(part > 0.1 * part.max()))]
    more = len(taking) - _NAMED
    return ", ".join(taking[:_NAMED]) + (f" and {more} more" if more > 0 else "")
