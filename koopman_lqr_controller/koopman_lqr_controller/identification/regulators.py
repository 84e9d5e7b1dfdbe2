"""Regulators equivalent to a learnt controller, for each latent size and projection family.

Projections C (r, n) have orthonormal rows, z = C psi, in two families. The future outputs of a law under a model
psi_{k+1} = A psi_k + ... depend on psi through K psi, K A psi, K A^2 psi, etc. `observed` keeps the first of these, so
that the reduced model predicts what the law needs; `principal` keeps the directions of largest variance, needed or not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.control.inverse_lqr import LinearLaw, fit_costs
from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.data.roll_outs import Episode
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import Snapshots
from koopman_lqr_controller.models.shrinkage import ShrinkageFit, fit_with_shrinkage

_NEW = 1e-6
"""Fraction of a row outside the span of the previous rows below which it adds only rounding."""


def observed(K: Array, A: Array, size: int) -> Array:
    """Return the first `size` directions of the rows of K, K A, K A^2, ... (at most size, n), by Arnoldi's method.

    Args:
        K: Gain (m, n).
        A: State matrix of the model (n, n).
        size: Maximum number of directions; fewer if the rows span fewer.
    """
    found = np.zeros((0, A.shape[0]))
    rows = list(K)
    while rows and len(found) < size:
        row = rows.pop(0)
        length = np.linalg.norm(row)
        for _ in range(2):  # a second pass removes the effect of rounding
            row = row - found.T @ (found @ row)
        left = np.linalg.norm(row)
        if left > _NEW * length:
            found = np.vstack((found, row / left))
            rows.append(found[-1] @ A)
    return found


def principal(deviations: Array, least: float) -> Array:
    """Return the directions of deviations (N, n), by decreasing variance (at most n, n).

    Args:
        deviations: Deviations from a reference (N, n).
        least: Minimum standard deviation relative to the first direction; others are omitted.
    """
    _, spread, directions = np.linalg.svd(deviations, full_matrices=False)
    return np.ascontiguousarray(directions[spread > least * spread[0]])


LARGEST_RESIDUAL = 1e-8
"""Maximum relative residual of the Riccati equation of an accepted regulator."""
_SEEN = 1e-4
"""Standard deviation relative to the first direction below which a latent direction is only rounding."""
_INSIDE = 0.9
"""Maximum action at the reference, so that the loop is linear around it."""
_LEAST_WEIGHT = 0.05


@dataclass(frozen=True)
class RegulatorCandidate:
    """A regulator for one projection.

    Attributes:
        controller: Infinite-horizon controller.
        family: Family of the projection: "observed" or "principal".
        mismatch: Remaining mismatch to the law: 0 for the same law, 1 for K = 0.
        contraction: Factor applied to the refitted A; 1 if A itself has a regulator.
        shrunk: Fit of the model.
    """

    controller: LatentController
    family: str
    mismatch: float
    contraction: float
    shrunk: ShrinkageFit


def reference_inside(z_ref: Array, u_ref: Array, K: Array, spread: Array) -> tuple[Array, Array]:
    """Return a reference of the law u = u_ref - K (z - z_ref) with an admissible action, and that action.

    If u_ref is inadmissible, the reference is moved to the nearest z, in the metric of `spread`, with an admissible u.

    Args:
        z_ref: Reference of z (n,).
        u_ref: Output of the law at the reference (m,).
        K: Gain (m, n).
        spread: Covariance of the observed latents (n, n).
    """
    a_ref = np.clip(u_ref, -_INSIDE, _INSIDE)
    along = spread @ K.T
    return z_ref + along @ np.linalg.pinv(K @ along) @ (u_ref - a_ref), a_ref


class RegulatorFitter:
    """Fits regulators to recorded drives, with a learnt controller's law as data and models of projections of psi.

    The models are shrunk towards persistence, because drives are short.

    Args:
        learnt: Learnt controller, with a finite horizon.
        episodes: Recorded drives as episodes.
        mirrored: The same drives with left and right swapped, equally valid.
        goal: Whether z_ref is a goal; otherwise the mean of the observed latents is used.

    Attributes:
        learnt: Learnt controller, with a finite horizon.
        directions: Directions of variation of psi, by decreasing variance (r, n).
    """

    def __init__(
        self, learnt: LatentController, episodes: Sequence[Episode], mirrored: Sequence[Episode], goal: bool
    ) -> None:
        self.learnt, self._episodes, self._mirrored = learnt, episodes, mirrored
        self._psi = np.concatenate([episode.features[:-1] for episode in (*episodes, *mirrored)])
        # The law's output is linear, but the action after tanh is not. Clipped instead, it differs by up to 0.24.
        self._u = learnt.control(self._psi)
        # Effect of a difference in u on the action: where it vanishes, the law need not match.
        self._weight = np.mean(1.0 - np.tanh(self._u) ** 2, axis=1) + _LEAST_WEIGHT
        self._psi_ref, self._a_ref = self._reference(goal)
        self.directions = principal(self._psi - self._psi_ref, _SEEN)
        self._A = self.shrunk(self.directions).model.A

    def _reference(self, goal: bool) -> tuple[Array, Array]:
        """Return the goal, or the weighted mean of the observed latents, and an action that holds it."""
        learnt = self.learnt
        psi_ref = learnt.z_ref if goal else np.average(self._psi, axis=0, weights=self._weight)
        spread = np.cov(self._psi.T, aweights=self._weight)
        return reference_inside(psi_ref, learnt.control(psi_ref), learnt.K, spread)

    def shrunk(self, C: Array) -> ShrinkageFit:
        """Return the model of C psi and the action around the reference, with details of the fit."""
        twin = self._snapshots(C, self._mirrored) if self._mirrored else None
        return fit_with_shrinkage(self._snapshots(C, self._episodes), twin, lifted=True)

    def _snapshots(self, C: Array, episodes: Sequence[Episode]) -> Snapshots:
        """Return drives as deviations of C psi and of the actions from the reference."""
        z = [(episode.features - self._psi_ref) @ C.T for episode in episodes]
        u = np.concatenate([episode.actions for episode in episodes]) - self._a_ref
        return Snapshots(np.concatenate([each[:-1] for each in z]), u, np.concatenate([each[1:] for each in z]))

    def projections(self, sizes: Sequence[int]) -> Iterator[tuple[str, Array]]:
        """Yield projections with their families, `observed` before `principal`, by increasing size.

        Sizes beyond the number of varying directions mean all of them.
        """
        n = len(self.directions)
        wanted = sorted({min(size, n) for size in sizes})
        K = self.learnt.K @ self.directions.T
        for size in wanted:
            C = observed(K, self._A, size)
            if len(C) == size < n:
                yield "observed", C @ self.directions
        for size in wanted:
            yield "principal", self.directions[:size]

    def regulator(self, family: str, C: Array) -> RegulatorCandidate | None:
        """Return the regulator for a projection, or None if the model has none.

        Directions that a weak policy never moves cannot and need not be regulated: if the refitted model has no
        regulator, a contracted model with stable modes is used instead, as stated in `contraction`.
        """
        shrunk, z_ref = self.shrunk(C), C @ self._psi_ref
        model, drift = shrunk.model, shrunk.drift
        law = LinearLaw.from_samples(self._psi @ C.T - z_ref, self._u - self._a_ref, self._weight)
        for contraction, each in ((1.0, model), model.contracted()):
            try:
                Q, R, mismatch = fit_costs(each, law, np.ones(len(C)), self.learnt.R)
            except KoopmanError:
                continue
            found = LatentController(self.learnt.encoder, each, Q, R, z_ref, None, C, self._a_ref, drift)
            if found.residual >= LARGEST_RESIDUAL:
                return None
            return RegulatorCandidate(found, family, mismatch, contraction, shrunk)
        return None
