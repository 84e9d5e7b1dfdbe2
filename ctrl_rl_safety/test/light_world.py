"""Lightweight world for property tests: static and moving discs, a lidar, and a robot that matches its model."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ctrl_rl_core.values import cached_njit
from ctrl_rl_safety.filter.certificate import outer_speed
from ctrl_rl_safety.models.motion import STANDS, motion_of, next_state
from numpy.typing import NDArray

from ctrl_rl_safety import Reading, RobotModel, SafetyFilter, Verdict

STEP = 0.02
_BEARINGS = np.radians(np.arange(0.0, 360.0, 2.0))


@cached_njit
def roll_out(state: NDArray[np.float64], commands: NDArray[np.float64], motion: Any) -> NDArray[np.float64]:
    """Return the states (n + 1, 5) from a state (5,) under commands (n, 2), one per time step."""
    out = np.empty((len(commands) + 1, 5))
    out[0] = state
    for k in range(len(commands)):
        x, y, theta, v, omega = out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4]
        out[k + 1] = np.array(next_state(x, y, theta, v, omega, commands[k, 0], commands[k, 1], motion))
    return out


class LightWorld:
    """Robot at the origin, discs (x, y, vx, vy, radius), and a filter between the raw commands and the robot."""

    def __init__(self, model: RobotModel, discs: NDArray[np.float64], safety: SafetyFilter, seed: int) -> None:
        self.model, self.safety = model, safety
        self.state, self.time = np.zeros(5), 0.0
        self._discs, self._random = discs, np.random.default_rng(seed)
        self._motion = motion_of(model, STEP)
        self._under_way: list[tuple[float, NDArray[np.float64]]] = []
        self._held, self._ticks = np.zeros(2), 0

    def scan(self) -> NDArray[np.float64]:
        x, y, theta = self.state[:3]
        c, s = np.cos(_BEARINGS + theta), np.sin(_BEARINGS + theta)
        best = np.full(len(_BEARINGS), 10.0)
        for (cx, cy), r in zip(self._places(), self._discs[:, 4], strict=True):
            along = (cx - x) * c + (cy - y) * s
            aside = (cx - x) ** 2 + (cy - y) ** 2 - along**2
            hit = (aside < r * r) & (along > 0.0)
            best[hit] = np.minimum(best[hit], along[hit] - np.sqrt(r * r - aside[hit]))
        echo = best < 9.0
        best = best + self._random.uniform(-1.0, 1.0, len(best)) * self.model.range_error
        return np.column_stack((best * np.cos(_BEARINGS), best * np.sin(_BEARINGS)))[echo]

    def tick(self, raw: NDArray[np.float64], with_set: bool) -> tuple[Verdict, float, float]:
        """Filter a command, advance by 0.06 s, and return the minimum clearance from static discs, and from movers
        while the robot moves.
        """
        if self._ticks % 4 == 0:
            self.safety.see(self.time, self.state[:3].copy(), self.scan())
            self.safety.use(self.safety.solve() if with_set else None)
        self._ticks += 1
        reading = Reading(self.state[:3].copy(), float(self.state[3]), float(self.state[4]))
        verdict = self.safety.decide(self.time, reading, raw)
        self.safety.sent(self.time, verdict.command)
        self._under_way.append((self.time + self.model.delay - 1e-9, verdict.command))
        standing = moving = math.inf
        for _ in range(3):
            while self._under_way and self._under_way[0][0] <= self.time:
                self._held = self._under_way.pop(0)[1]
            self.state = roll_out(self.state, self._held[None], self._motion)[1]
            self.time += STEP
            gaps = self._away() - self._discs[:, 4] - (0.0 if self.model.length else self.model.radius)
            stands = (self._discs[:, 2:4] == 0.0).all(axis=1)
            standing = min(standing, *gaps[stands], math.inf)
            if outer_speed(self.state[3], self.state[4], self.model.core) >= STANDS:
                moving = min(moving, *gaps[~stands], math.inf)
        return verdict, standing, moving

    def _away(self) -> NDArray[np.float64]:
        """Return the distances from the discs' centres to the robot's core."""
        x, y, theta = self.state[:3]
        c, s = np.cos(theta), np.sin(theta)
        beside = np.abs((self._places() - (x, y)) @ np.array(((c, -s), (s, c)))) - self.model.core
        return np.hypot(*np.maximum(beside, 0.0).T)

    def _places(self) -> NDArray[np.float64]:
        return self._discs[:, :2] + self.time * self._discs[:, 2:4]
