"""What the observations of a scan have in common."""

from __future__ import annotations

import math

from koopman_lqr_controller.errors import KoopmanError

STEP_TOLERANCE = 0.25
"""Part by which a step from scan to scan may be shorter or longer than another and still count as the same."""


def check_speeds(v: float, omega: float) -> None:
    """Refuse the odometry that a scan is seen with.

    Raises:
        KoopmanError: speed or turn rate are not finite.
    """
    if not (math.isfinite(v) and math.isfinite(omega)):
        raise KoopmanError(f"odometry with speed {v} and turn rate {omega}")
