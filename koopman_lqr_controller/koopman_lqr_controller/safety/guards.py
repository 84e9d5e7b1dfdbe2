"""What training saw, and guards that stop a robot outside of it: pure logic, time is passed in.

Two alarms watch a policy: that of the region, which the latent may not leave, and that of the prediction, whose error
may not stay high. Each rises when what it watches was above its limit for some time, and ends when it was well below
for as long. An error that stays high because the robot stands would never end: it may try again, slowly, some times.
"""

from __future__ import annotations

import math
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
RELEASE = 0.8
"""Part of the limit below which an alarm ends: what hovers at the limit does not stop and go."""
RETRY_SCALE = 0.5
"""Part of a command that is carried out during a retry."""
RETRY_SECONDS = 3.0
"""Duration of one retry [s]."""
FORGET_SECONDS = 10.0
"""Time without an alarm after which former retries no longer count [s]."""
MAX_GAP_SECONDS = 1.0
"""Values that are further apart say nothing of the time between them [s]."""


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


@dataclass
class Alarm:
    """A limit with patience and hysteresis.

    Attributes:
        limit: Limit of the watched value; 0 for none.
        patience: Time that the value may stay above the limit, and must stay below RELEASE of it again [s].
        raised: Whether it stayed above for too long.
    """

    limit: float
    patience: float = 0.0
    raised: bool = False
    _since: float = field(default=math.nan, repr=False)
    _last: float = field(default=math.nan, repr=False)

    def end(self) -> None:
        """End the alarm and forget all values."""
        self.raised, self._since = False, math.nan

    def update(self, now: float, value: float) -> bool:
        """Update with a value at a time [s], NaN for none, and return whether the alarm is raised."""
        if self.limit <= 0.0:
            self.end()
        elif not math.isnan(value):
            if not now - self._last <= MAX_GAP_SECONDS:
                self._since = math.nan
            self._last = now
            wrong = value < RELEASE * self.limit if self.raised else value > self.limit
            if not wrong:
                self._since = math.nan
            else:
                if not self._since <= now:  # the first time, or the clock was set back
                    self._since = now
                if now - self._since >= self.patience:
                    self.raised, self._since = not self.raised, math.nan
        return self.raised


@dataclass
class Retries:
    """A way out of an alarm that only driving can end: stand, then try again slowly, a bounded number of times.

    Attributes:
        wait: Time that the robot stands before it tries again [s].
        most: Largest number of retries; 0 for none.
        used: Number of retries since all was well for `FORGET_SECONDS`.
    """

    wait: float
    most: int
    used: int = 0
    _creeping: bool = field(default=False, repr=False)
    _since: float = field(default=math.nan, repr=False)
    _well_since: float = field(default=math.nan, repr=False)

    def update(self, now: float, alarm: bool) -> float:
        """Return the part of a command that is to be carried out: 1 without an alarm, 0 to stand, CREEP to try again.

        Args:
            now: Present time [s].
            alarm: Whether the alarm is raised.
        """
        if not alarm:
            self._creeping, self._since = False, math.nan
            if not self._well_since <= now:
                self._well_since = now
            if now - self._well_since >= FORGET_SECONDS:
                self.used = 0
            return 1.0
        self._well_since = math.nan
        if not self._since <= now:  # the alarm is new, or the clock was set back
            self._since, self._creeping = now, False
        if self._creeping and now - self._since >= RETRY_SECONDS:
            self._creeping, self._since = False, now
        elif not self._creeping and self.used < self.most and now - self._since >= self.wait:
            self._creeping, self._since = True, now
            self.used += 1
        return RETRY_SCALE if self._creeping else 0.0


class Guard:
    """Holds a policy's latents and prediction errors against what training saw.

    Attributes:
        distribution: Latent distribution of the policy; None where its file has none: then nothing is watched.
        distance: Distance of the last latent over that of the border; NaN without a distribution.
        speed_scale: Part of the command to carry out where nothing stops the robot; below 1 on a retry.
        retries: Retries of an alarm that only driving can end.
    """

    def __init__(
        self,
        distribution: LatentDistribution | None,
        largest_distance: float,
        largest_error: float,
        error_patience: float,
    ) -> None:
        """Make a guard.

        Args:
            distribution: Latent distribution of the policy; None to watch nothing.
            largest_distance: Largest distance of a latent, over that of the border; 0 for any.
            largest_error: Largest prediction error that may stay, over that of training; 0 for any.
            error_patience: Time that the error may stay above its limit [s].
        """
        self.distribution, self.distance = distribution, math.nan
        self.speed_scale, self.retries = 1.0, Retries(math.inf, 0)
        self._distance_alarm, self._error_alarm = Alarm(0.0), Alarm(0.0)
        self.set_limits(largest_distance, largest_error, error_patience)

    def set_limits(self, largest_distance: float, largest_error: float, error_patience: float) -> None:
        """Change the limits; a raised alarm stays raised until its own limit ends it."""
        self._distance_alarm.limit = largest_distance
        self._error_alarm.limit, self._error_alarm.patience = largest_error, error_patience

    def set_retries(self, wait: float, most: int) -> None:
        """Let the robot try again slowly after it stood for `wait` [s] for its prediction error, `most` times."""
        self.retries.wait, self.retries.most = wait, most

    def reset_prediction_alarm(self) -> None:
        """End the alarm of the prediction: there will be no more errors to end it."""
        self._error_alarm.end()

    def update(self, now: float, z: Array, error: float) -> str:
        """Return why the robot must stop, empty where it need not.

        Args:
            now: Time of the scan [s].
            z: Its latent (n,).
            error: |z - z_predicted|; NaN where nothing was predicted.
        """
        if self.distribution is None:
            return ""
        self.distance = self.distribution.relative_distance(z)
        left = self._distance_alarm.update(now, self.distance)
        missed = self._error_alarm.update(now, error / self.distribution.error)
        self.speed_scale = self.retries.update(now, missed)
        if left:
            return "the latent has left the region seen in training (parameter largest_distance)"
        if self.speed_scale == 0.0:
            return "the prediction error stays high (parameter largest_error)"
        return ""
