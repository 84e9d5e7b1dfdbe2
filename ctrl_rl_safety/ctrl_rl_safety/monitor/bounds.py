"""Bounds of a robot's motion: those of its model, extended by measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ctrl_rl_safety.models.robot_model import LARGEST, UNITS, RobotModel

LEAST_BRAKING = 0.3
"""Braking that a robot must have, as a fraction of the stated one."""
LEAST_TURNING = 0.25
"""Turn acceleration that a robot must have, as a fraction of the stated one."""
MOST_ACCELERATION = 100.0
"""Acceleration of a robot that executes each command at once [m/s^2]."""


@dataclass(frozen=True)
class Bounds:
    """Deviations of a robot from its model, for the worse; none by default.

    Attributes:
        delay: Additional delay [s].
        acceleration: Acceleration relative to the stated one.
        braking: Braking relative to the stated one.
        turning: Turn acceleration relative to the stated one.
        disturbance: Additional disturbance [m/s].
    """

    delay: float = 0.0
    acceleration: float = 1.0
    braking: float = 1.0
    turning: float = 1.0
    disturbance: float = 0.0

    def beside(self, other: Bounds) -> Bounds:
        """Return the worse of both in each respect."""
        return Bounds(
            max(self.delay, other.delay),
            max(self.acceleration, other.acceleration),
            min(self.braking, other.braking),
            min(self.turning, other.turning),
            max(self.disturbance, other.disturbance),
        )

    def of(self, stated: RobotModel) -> RobotModel:
        """Return a model with these bounds."""
        if self == Bounds():
            return stated
        return replace(
            stated,
            delay=min(stated.delay + self.delay, LARGEST["delay"]),
            acceleration=max(min(stated.acceleration * self.acceleration, MOST_ACCELERATION), stated.acceleration),
            braking=stated.braking * self.braking,
            turn_acceleration=stated.turn_acceleration * self.turning,
            disturbance=min(stated.disturbance + self.disturbance, LARGEST["disturbance"]),
        )


_NAMES = ("delay", "acceleration", "braking", "turn_acceleration", "disturbance")


def differences(model: RobotModel, stated: RobotModel) -> dict[str, str]:
    """Describe the differences between a model and the stated one, by the name of the constant."""
    out = {}
    for name in _NAMES:
        now, before = getattr(model, name), getattr(stated, name)
        if now != before:
            out[name] = f"{now:.3g} {UNITS[name]} instead of {before:.3g}"
    return out
