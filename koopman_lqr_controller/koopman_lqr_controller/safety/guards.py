"""Training distribution, and guards that stop a robot outside of it. No ROS; time is an argument.

Two alarms monitor a policy: the region alarm, for a latent outside the training region, and the prediction alarm, for a
persistently high prediction error. Each is raised when its value has exceeded the limit for some time, and ends when
the value has been well below for as long. An error that stays high because the robot is stopped would never end, so the
robot may retry slowly a limited number of times.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError

INSIDE = 99.9
"""Percentile of the training distances that defines the border of the region."""
PREDICTED = 99.0
"""Percentile of the training one-step prediction errors above which an error counts as high."""
_LEAST_SPREAD = 1e-6
"""Standard deviation relative to the first direction below which a direction is only single-precision rounding."""
RELEASE = 0.8
"""Fraction of the limit below which an alarm ends, to avoid toggling at the limit."""
RETRY_SCALE = 0.5
"""Fraction of a command executed during a retry."""
RETRY_SECONDS = 3.0
"""Duration of one retry [s]."""
FORGET_SECONDS = 10.0
"""Time without an alarm after which earlier retries no longer count [s]."""
MAX_GAP_SECONDS = 1.0
"""Interval between values above which they say nothing about the time in between [s]."""


@dataclass(frozen=True)
class LatentDistribution:
    """Gaussian of the latents in training, with the limits of usual distances and prediction errors.

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

    @property
    def whitening(self) -> Array:
        """Matrix (n, n) that turns a deviation from the mean into one whose length is the Mahalanobis distance."""
        return self._whitening

    def distances(self, z: Array) -> Array:
        """Return Mahalanobis distances (N,) of latents (N, n) from the mean."""
        return np.linalg.norm((z - self.mean) @ self._whitening.T, axis=-1)

    def relative_distance(self, z: Array) -> float:
        """Return the distance of one latent (n,) relative to the border's; above 1 is outside."""
        white = self._whitening.dot(z - self.mean)
        return float(np.sqrt(white.dot(white))) / self.distance


def check_distribution(distribution: LatentDistribution | None, size: int) -> None:
    """Raise if a distribution does not match the latents.

    Raises:
        KoopmanError: The sizes differ.
    """
    if distribution is not None and len(distribution.mean) != size:
        raise KoopmanError(f"the region is of {len(distribution.mean)} dimensions, the latent has {size}")


def fit_distribution(latents: Array, errors: Array) -> LatentDistribution:
    """Fit the region to latents (N, n) and their one-step prediction errors |z - z_predicted| (M,).

    Raises:
        KoopmanError: There are not more latents than dimensions, no errors, or values are not finite.
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
    """Fit the region to executed episodes.

    Args:
        predict: Returns the next z (N, n) for z (N, n) and actions (N, m).
        z: Latents of each episode (T + 1, n).
        actions: Actions of each episode (T, m).

    Raises:
        KoopmanError: As for `fit_distribution`.
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
        limit: Limit of the monitored value; 0 for none.
        patience: Time for which the value may exceed the limit, and must later stay below RELEASE times the limit [s].
        raised: Whether the alarm is raised.
    """

    limit: float
    patience: float = 0.0
    raised: bool = False
    _since: float = field(default=math.nan, repr=False)
    _last: float = field(default=math.nan, repr=False)

    def end(self) -> None:
        """End the alarm and discard all values."""
        self.raised, self._since = False, math.nan

    def update(self, now: float, value: float) -> bool:
        """Process a value at a time [s], NaN for none, and return whether the alarm is raised."""
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
                if not self._since <= now:  # the first value, or the clock was set back
                    self._since = now
                if now - self._since >= self.patience:
                    self.raised, self._since = not self.raised, math.nan
        return self.raised


@dataclass
class Retries:
    """Handles an alarm that only driving can end: stop, then retry slowly, a limited number of times.

    Attributes:
        wait: Time for which the robot stops before a retry [s].
        most: Maximum number of retries; 0 for none.
        used: Number of retries since the last `FORGET_SECONDS` without an alarm.
    """

    wait: float
    most: int
    used: int = 0
    _creeping: bool = field(default=False, repr=False)
    _since: float = field(default=math.nan, repr=False)
    _well_since: float = field(default=math.nan, repr=False)

    def update(self, now: float, alarm: bool) -> float:
        """Return the fraction of a command to execute: 1 without an alarm, 0 to stop, RETRY_SCALE for a retry.

        Args:
            now: Current time [s].
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
    """Compares a policy's latents and prediction errors with those of training.

    Attributes:
        distribution: Latent distribution of the policy; None if its file has none, which disables the guard.
        distance: Distance of the last latent relative to the border's; NaN without a distribution.
        speed_scale: Fraction of the command to execute if the robot need not stop; below 1 in a retry.
        retries: Retries of an alarm that only driving can end.
    """

    def __init__(
        self,
        distribution: LatentDistribution | None,
        largest_distance: float,
        largest_error: float,
        error_patience: float,
    ) -> None:
        """Create a guard.

        Args:
            distribution: Latent distribution of the policy; None to disable the guard.
            largest_distance: Maximum distance of a latent relative to the border's; 0 for no limit.
            largest_error: Maximum persistent prediction error relative to training; 0 for no limit.
            error_patience: Time for which the error may exceed its limit [s].
        """
        self.distribution, self.distance = distribution, math.nan
        self.speed_scale, self.retries = 1.0, Retries(math.inf, 0)
        self._distance_alarm, self._error_alarm = Alarm(0.0), Alarm(0.0)
        self.set_limits(largest_distance, largest_error, error_patience)

    def set_limits(self, largest_distance: float, largest_error: float, error_patience: float) -> None:
        """Change the limits; a raised alarm stays raised until its own condition ends it."""
        self._distance_alarm.limit = largest_distance
        self._error_alarm.limit, self._error_alarm.patience = largest_error, error_patience

    def set_retries(self, wait: float, most: int) -> None:
        """Allow `most` slow retries, each after a stop of `wait` [s] due to the prediction error."""
        self.retries.wait, self.retries.most = wait, most

    def reset_prediction_alarm(self) -> None:
        """End the prediction alarm, because no further errors will arrive to end it."""
        self._error_alarm.end()

    def update(self, now: float, z: Array, error: float) -> str:
        """Return the reason why the robot must stop, or "" if it need not.

        Args:
            now: Time of the scan [s].
            z: Latent of the scan (n,).
            error: |z - z_predicted|; NaN without a prediction.
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
