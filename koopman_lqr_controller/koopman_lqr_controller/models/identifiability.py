"""What recorded data tell of z_{k+1} = A z_k + B u_k, and what they cannot: one set of checks, before any fit.

All of it is decided in columns around their means over their spreads, so that neither units nor an offset matter. The
controls are judged by what is left of them once the state and a constant are taken away (Frisch-Waugh-Lovell): a model
can owe to a control only what the control does on its own (Proctor, Brunton, Kutz 2016: A and B are told apart only
where the controls are no function of the state).
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
"""Spread of a control over its size below which it does not move: of 16 digits fewer than 7 are left of the motion."""
_ON_ITS_OWN = 1e-8
"""Part of a control that is its own below which B would be rounding: no command is known to 8 digits, nor is A."""
_WEAK = 0.1
"""Part of a control that is its own below which noise can take its place, so that noise is asked for."""
_KNOWN = 5.0
"""Effect of a weak control over its standard error that is asked for.

B is then wrong by a factor of 0.6 to 1.4 at two standard errors. An LQR stays stable from half of its gain on, so this
is what a regulator bears.
"""
_DRIFT = 0.05
"""Part of A and B that a constant may change: less is what a linear model of a bent system misses anyway."""
_EXPLAINED = 0.1
"""Part of the error that is left where a constant explains it: then it is no bend."""
_NAMED = 6
"""Columns that a message names; of more it gives the number."""
_ROUNDED = 1e3
"""Rounding errors of data that may add up."""


@dataclass(frozen=True)
class RegressionData:
    """Snapshots whose shapes and values were checked.

    Attributes:
        z: States (N, n).
        u: Controls (N, m).
        z_next: Next states (N, n).
        eps: Precision of their numbers: that of the coarsest type.
    """

    z: Array
    u: Array
    z_next: Array
    eps: float

    @classmethod
    def of(cls, z: ArrayLike, u: ArrayLike, z_next: ArrayLike) -> RegressionData:
        """Return the data as float64.

        Raises:
            KoopmanError: other shapes than (N, n), (N, m) and (N, n), no rows, or values that are not finite numbers.
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
        """Refuse data of other shapes than some others.

        Raises:
            KoopmanError: tells both.
        """
        for name, mine, given in (("z", self.z, other.z), ("u", self.u, other.u)):
            if mine.shape != given.shape:
                raise KoopmanError(
                    f"{name} of the twin has shape {mine.shape}, must have {given.shape}, one row for each"
                )


def _precision(values: ArrayLike) -> float:
    """Return the relative rounding of some numbers: that of their type where it is a coarser one than float64."""
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
    """Refuse controls (N, m) that stand still, or move together.

    Args:
        u: Controls as they were recorded (N, m).
        names: Names of the controls for the message (m,); "control 0" and so on unless given.

    Raises:
        KoopmanError: names the controls, or a value that is not finite.
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
    """Refuse data from which B cannot be told, however A is chosen.

    Args:
        data: Snapshots that were checked.
        lifted: Whether z holds many functions that nearly repeat each other, or noise: what they miss is then no noise
            of the state, and counts only beside controls of which little is their own.

    Raises:
        KoopmanError: names the controls and says what to record.
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
    # A control is known to so many digits of itself, offset included, and not of its spread.
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
    """Refuse a control whose own part noise hides or could have made.

    All columns are deviations over their spreads, in any orthonormal coordinates of the rows.

    Args:
        index: Index of the control.
        z: States, of unit length (rows, n).
        u: Controls, of unit length (rows, m).
        z_next: Next states, of the length that as many unit spreads have (rows, n).
        noise: Part of each next state's spread that a linear model misses (n,).
        lifted: As in `check_controls_told`.
    """
    others = np.hstack((z, np.delete(u, index, axis=1)))
    own = _without(u[:, index], _orthonormal(others))
    size = float(np.linalg.norm(own))
    effect = np.abs(own @ z_next) / (size * np.maximum(noise, np.finfo(float).tiny))
    # Noise of measured states looks like a dither of a control that follows them: K times what the model misses.
    feedback = np.linalg.lstsq(others, u[:, index], rcond=1e-10)[0][: len(noise)]
    alike = float(np.linalg.norm(feedback * noise))
    weak = size < _WEAK
    if (weak and effect.max() < _KNOWN) or (size < alike and (weak or not lifted)):
        raise KoopmanError(
            f"control {index}: all but {100 * size:.2g} % follows from the state and other controls, too little for B "
            "beside the noise: add a larger dither of its own to each control while recording, or record for longer"
        )


def check_rows(data: RegressionData) -> None:
    """Refuse as few rows as unknowns or fewer.

    Raises:
        KoopmanError: says how many there must be.
    """
    least = data.z.shape[1] + data.u.shape[1] + 2
    if len(data.z) < least:
        raise KoopmanError(
            f"{len(data.z)} snapshots are too few for {data.z.shape[1]} observables and {data.u.shape[1]} controls: "
            f"record at least {least}, better ten times as many"
        )


def check_states_told(data: RegressionData) -> None:
    """Refuse states that are zero or that repeat each other: A is not unique then.

    Raises:
        KoopmanError: names the states.
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
    """Refuse data that a constant explains much better: A and B of a model without a drift would bend to stand for it.

    Args:
        data: Snapshots that were checked.
        W: Least-squares coefficients without a constant (n + m, n).

    Raises:
        KoopmanError: says what to take away.
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
    """Return what is left of columns outside an orthonormal span; twice, against rounding."""
    for _ in range(2):
        values = values - span @ (span.T @ values)
    return values


def _named(weights: Array, names: Sequence[str]) -> str:
    """Return the names of the columns that take part in a combination."""
    part = np.abs(weights)
    taking = [names[index] for index in map(int, np.flatnonzero(part > 0.1 * part.max()))]
    more = len(taking) - _NAMED
    return ", ".join(taking[:_NAMED]) + (f" and {more} more" if more > 0 else "")
