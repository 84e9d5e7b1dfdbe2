"""The dynamic window approach (D. Fox, W. Burgard, S. Thrun, The dynamic window approach to collision avoidance, 1997).

Commands are sampled from the window that the accelerations allow within one period. Each command drives an arc; its
clearance is the distance along the arc to the first echo. A command is admissible if the robot can stop within its
clearance (Eq. 14 there). The best one maximises a weighted sum of heading, clearance and speed (Eq. 13), each scaled to
0 .. 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.values import cached_njit
from ctrl_rl_navigation.robot import DriveLimits
from numpy.typing import NDArray

Array = NDArray[np.float64]

_STEP = 0.1
"""Step length along an arc [m]; when the robot turns on the spot, the step of its corner."""


@dataclass(frozen=True)
class DynamicWindowOptions:
    """Settings of the controller, with the weights of the paper's section 5.

    Attributes:
        heading: Weight of the alignment with the goal after the command's period.
        clearance: Weight of the distance to the first echo.
        speed: Weight of the speed.
        speeds: Number of sampled speeds.
        turns: Number of sampled turn rates.
        reach: Distance beyond which echoes are ignored [m].
        ahead: Time at which the predicted heading is compared with the direction to the goal [s].
        period: Time between two commands [s].
        delay: Time from a command to its effect, plus the time until the next command [s].
        deceleration: Braking deceleration of the robot [m/s^2].
    """

    heading: float = 2.0
    clearance: float = 0.2
    speed: float = 0.2
    speeds: int = 9
    turns: int = 41
    reach: float = 3.0
    ahead: float = 0.5
    period: float = 0.05
    delay: float = 0.1
    deceleration: float = 4.0


@cached_njit
def _clearances(
    commands: Array, points: Array, half_length: float, half_width: float, gap: float, reach: float
) -> Array:
    """Return the free distance along the arc of each command (n,) [m], at most `reach`."""
    out = np.full(len(commands), reach)
    corner = math.hypot(half_length, half_width)
    for i in range(len(commands)):
        v, omega = commands[i, 0], commands[i, 1]
        speed = v + corner * abs(omega) if v < 1e-3 else v
        if speed < 1e-6:
            continue
        step = _STEP / speed
        for k in range(1, int(reach / _STEP) + 1):
            t = k * step
            theta = omega * t
            bend = 0.5 * theta
            chord = v * t * (math.sin(bend) / bend if abs(bend) > 1e-9 else 1.0)
            x, y, c, s = chord * math.cos(bend), chord * math.sin(bend), math.cos(theta), math.sin(theta)
            hit = False
            for j in range(len(points)):
                dx, dy = points[j, 0] - x, points[j, 1] - y
                along = max(abs(c * dx + s * dy) - half_length, 0.0)
                aside = max(abs(c * dy - s * dx) - half_width, 0.0)
                if along * along + aside * aside < gap * gap:
                    hit = True
                    break
            if hit:
                out[i] = (k - 1) * _STEP
                break
    return out


class DynamicWindow:
    """Dynamic-window controller of one robot."""

    def __init__(self, limits: DriveLimits, options: DynamicWindowOptions | None = None) -> None:
        self.limits, self.options = limits, options or DynamicWindowOptions()

    def choose(self, goal: Array, motion: Array, points: Array) -> Array:
        """Return the command: speed and turn rate (2,) [m/s, rad/s].

        Args:
            goal: Position of the goal in the robot's frame (2,) [m].
            motion: Current speed and turn rate (2,) [m/s, rad/s].
            points: Echoes in the robot's frame (n, 2) [m].
        """
        limits, settings = self.limits, self.options
        commands = self._window(motion)
        near = points[np.hypot(points[:, 0], points[:, 1]) < settings.reach + limits.length]
        free = _clearances(commands, near, 0.5 * limits.length, 0.5 * limits.width, limits.gap, settings.reach)
        v, omega = commands.T
        stops = v * settings.delay + 0.5 * v**2 / settings.deceleration
        admissible = (stops <= free) & ((v > 1e-3) | (free > 0.0) | (np.abs(omega) < 1e-3))
        if not admissible.any():
            return np.array((0.0, 0.0))
        turned = omega * settings.ahead
        x, y = v * settings.ahead * np.cos(0.5 * turned), v * settings.ahead * np.sin(0.5 * turned)
        error = np.arctan2(goal[1] - y, goal[0] - x) - turned
        heading = 1.0 - np.abs((error + math.pi) % (2.0 * math.pi) - math.pi) / math.pi
        value = settings.heading * heading + settings.clearance * free / settings.reach
        value += settings.speed * v / limits.speed
        best = int(np.argmax(np.where(admissible, value, -np.inf)))
        return np.asarray(commands[best], float)

    def _window(self, motion: Array) -> Array:
        """Return the commands (n, 2) that the robot can reach within one period."""
        limits, settings = self.limits, self.options
        step, turn = limits.acceleration * settings.period, limits.turn_acceleration * settings.period
        low, high = np.clip((motion[0] - step, motion[0] + step), 0.0, limits.speed)
        left, right = np.clip((motion[1] - turn, motion[1] + turn), -limits.turn_rate, limits.turn_rate)
        speeds, turns = np.linspace(low, high, settings.speeds), np.linspace(left, right, settings.turns)
        return np.stack(np.meshgrid(speeds, turns, indexing="ij"), axis=-1).reshape(-1, 2)
