"""The distribution of latents and prediction errors in training, which a robot's own are compared with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError

INSIDE = 99.9
"""Percentile of the distances in training that is the border of the region."""
PREDICTED = 99.0
"""Percentile of the one-step prediction errors in training above which an error is high."""
_LEAST_SPREAD = 1e-6
"""Directions that vary by less than this part of the first one say nothing but the rounding of single precision."""


@dataclass(frozen=True)
class LatentDistribution:
    """Gaussian of the latents in training, with the border of usual distances and prediction errors.

    Attributes:
        mean: Mean of the latents (n,).
        covariance: Covariance of the latents (n, n), symmetric.
        distance: Mahalanobis distance of the border.
        error: |z - z_predicted| above which a prediction error is high.
    """

    mean: Array
    covariance: Array
    distance: float
    error: float
    _whitening: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        n = len(self.mean) if self.mean.ndim == 1 else 0
        if n == 0 or self.covariance.shape != (n, n):
            raise KoopmanError(
                f"the region's mean and covariance have shapes {self.mean.shape}, {self.covariance.shape}"
            )
        if not (np.isfinite(self.mean).all() and np.isfinite(self.covariance).all()):
            raise KoopmanError("the region holds values that are not finite")
        if not (0.0 < self.distance < np.inf and 0.0 < self.error < np.inf):
            raise KoopmanError(f"the region's distance {self.distance} and error {self.error} must be positive numbers")
        variance, directions = np.linalg.eigh(self.covariance)
        if not variance[-1] > 0.0:
            raise KoopmanError("the region's covariance is not positive")
        spread = np.sqrt(np.maximum(variance, _LEAST_SPREAD**2 * variance[-1]))
        object.__setattr__(self, "_whitening", np.ascontiguousarray((directions / spread).T))

    def distances(self, z: Array) -> Array:
        """Return Mahalanobis distances (N,) of latents (N, n) from the mean."""
        return np.linalg.norm((z - self.mean) @ self._whitening.T, axis=-1)

    def relative_distance(self, z: Array) -> float:
        """Return the distance of one latent (n,) over that of the border: above 1 is outside."""
        white = self._whitening.dot(z - self.mean)
        return float(np.sqrt(white.dot(white))) / self.distance


def check_distribution(distribution: LatentDistribution | None, size: int) -> None:
    """Refuse a region of other latents.

    Raises:
        KoopmanError: it is of another size.
    """
    if distribution is not None and len(distribution.mean) != size:
        raise KoopmanError(f"the region is of {len(distribution.mean)} dimensions, the latent has {size}")


def fit_distribution(latents: Array, errors: Array) -> LatentDistribution:
    """Return the region of latents (N, n) and their one-step prediction errors |z - z_predicted| (M,).

    Raises:
        KoopmanError: there are no more latents than dimensions, no errors, or values that are not finite.
    """
    if latents.ndim != 2 or len(latents) <= latents.shape[1] or errors.ndim != 1 or len(errors) == 0:
        raise KoopmanError(
            f"cannot fit a region to latents {latents.shape} and prediction errors {errors.shape}: "
            "there must be more latents than dimensions, and at least one error"
        )
    if not (np.isfinite(latents).all() and np.isfinite(errors).all()):
        raise KoopmanError("latents or prediction errors hold values that are not finite")
    mean, covariance = latents.mean(axis=0), np.atleast_2d(np.cov(latents.T))
    distances = LatentDistribution(mean, covariance, 1.0, 1.0).distances(latents)
    return LatentDistribution(
        mean, covariance, float(np.percentile(distances, INSIDE)), float(np.percentile(errors, PREDICTED))
    )


def fit_distribution_to_episodes(
    predict: Callable[[Array, Array], Array], z: Sequence[Array], actions: Sequence[Array]
) -> LatentDistribution:
    """Return the region of episodes that were lived through.

    Args:
        predict: Next z (N, n) of z (N, n) and actions (N, m).
        z: Latents of each episode (T + 1, n).
        actions: Actions of each episode (T, m).

    Raises:
        KoopmanError: as `fit_distribution`.
    """
    errors = [
        np.linalg.norm(here[1:] - predict(here[:-1], done), axis=1) for here, done in zip(z, actions, strict=True)
    ]
    if not errors:
        raise KoopmanError("no episodes to fit a region to")
    return fit_distribution(np.concatenate(list(z)), np.concatenate(errors))
