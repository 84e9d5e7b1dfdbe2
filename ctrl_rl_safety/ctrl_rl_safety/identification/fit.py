"""Fits the constants of the filter's motion model to a drive.

Delay, lag and acceleration limits minimise the squared error of speed and turn rate when the model receives the drive's
commands. Among equally good limits the smallest are taken, because the robot certainly attains them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.values import cached_njit
from numpy.typing import NDArray

from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.identification.drive import STEP, Drive
from ctrl_rl_safety.models.motion import Motion, next_speeds, next_state

Array = NDArray[np.float64]

_MOVES = (0.05, 0.1)
"""Minimum speed [m/s] and turn rate [rad/s] that a drive must reach."""
_TOP = 99.0
"""Percentile of the speeds that counts as the maximum, because a single reading may be wrong."""
_LONGEST = 50
"""Maximum delay in rows."""
_DELAYS = range(0, _LONGEST + 1, 2)
_LAGS = np.array((0.0, 0.03, 0.06, 0.1, 0.2, 0.4))
_LIMITS = np.geomspace(0.05, 20.0, 18)
_AS_GOOD = 1.01
_NONE = 1e-2
"""Acceleration limit beyond any robot [m/s^2, rad/s^2]."""
_NAMES = ("start", "stop", "change of the turn rate")
_SPAN = 1.0
"""Duration over which the position deviation is measured [s]."""
_PERCENTILE = 99.0


@dataclass(frozen=True)
class Fit:
    """Constants of a robot identified from drives.

    Attributes:
        speed: Maximum forward speed [m/s].
        reverse_speed: Maximum reverse speed [m/s]; 0 if the robot never drove backwards.
        turn_rate: Maximum turn rate [rad/s].
        acceleration: Maximum rate of change of the speed away from zero [m/s^2].
        braking: Maximum rate of change of the speed towards zero [m/s^2].
        turn_acceleration: Maximum angular acceleration [rad/s^2].
        lag: Time constant of the speeds [s].
        delay: Time from a command to its effect in the odometry [s].
        disturbance: Deviation of the position from the model per second [m/s].
        error: Unexplained fraction of the variance of speed and turn rate.
    """

    speed: float
    reverse_speed: float
    turn_rate: float
    acceleration: float
    braking: float
    turn_acceleration: float
    lag: float
    delay: float
    disturbance: float
    error: float


@cached_njit
def _errors(commands: Array, speeds: Array, ends: NDArray[np.int64], motion: Motion) -> Array:
    """Return the squared errors of speed and turn rate (2,) of a simulated motion."""
    out, first = np.zeros(2), 0
    for last in ends:
        v, omega = speeds[first, 0], speeds[first, 1]
        for k in range(first, last):
            v, omega = next_speeds(v, omega, commands[k, 0], commands[k, 1], motion)
            out[0] += (v - speeds[k, 0]) ** 2
            out[1] += (omega - speeds[k, 1]) ** 2
        first = last
    return out


@cached_njit
def _deviations(
    commands: Array, poses: Array, speeds: Array, ends: NDArray[np.int64], motion: Motion, span: int
) -> Array:
    """Return the deviation of the position from the model after each `span` rows."""
    out, count, first = np.empty(len(poses)), 0, 0
    for last in ends:
        for begin in range(first, last - span, max(span // 10, 1)):
            x, y, theta = poses[begin, 0], poses[begin, 1], poses[begin, 2]
            v, omega = speeds[begin, 0], speeds[begin, 1]
            for k in range(begin + 1, begin + span + 1):
                x, y, theta, v, omega = next_state(x, y, theta, v, omega, commands[k, 0], commands[k, 1], motion)
            end = begin + span
            out[count] = np.hypot(poses[end, 0] - x, poses[end, 1] - y)
            count += 1
        first = last
    return out[:count]


class _Data:
    """Concatenated drives, with commands that take effect after a delay.

    Each drive starts after the maximum delay, because the command in effect before that is unknown.
    """

    def __init__(self, drives: Sequence[Drive], top: tuple[Array, Array], track: float) -> None:
        self._drives, self._top, self._track = drives, top, track
        self.speeds = np.concatenate([each.speeds[_LONGEST:] for each in drives])
        self.poses = np.concatenate([each.poses[_LONGEST:] for each in drives])
        self.ends = np.cumsum([len(each.speeds) - _LONGEST for each in drives])
        self._scale = np.maximum(((self.speeds - self.speeds.mean(axis=0)) ** 2).sum(axis=0), 1e-9)

    def commands(self, rows: int) -> Array:
        """Return the commands (n, 2) in effect, delayed by `rows` rows."""
        late = [each.commands[_LONGEST - rows : len(each.commands) - rows] for each in self._drives]
        return np.clip(np.concatenate(late), *self._top)

    def errors(self, commands: Array, lag: float, limits: Array) -> Array:
        """Return the unexplained fraction of the variance of speed and of turn rate (2,)."""
        return np.asarray(_errors(commands, self.speeds, self.ends, self.motion(lag, limits)) / self._scale)

    def motion(self, lag: float, limits: Array) -> Motion:
        """Return the motion model for one row, with a lag [s] and acceleration limits (3,)."""
        share = 1.0 if lag <= 0.0 else -math.expm1(-STEP / lag)
        faster, slower, turn = (limits * STEP).tolist()
        return Motion(STEP, share, faster, slower, turn, 0.5 * self._track)


def fit_drives(drives: Sequence[Drive], track: float = 0.0) -> Fit:
    """Identify the constants from drives.

    Args:
        drives: Segments of drives.
        track: Distance between two driven wheels [m]; 0 if speed and turn rate change independently.

    Raises:
        SafetyError: The robot never moved, turned, started or stopped, or did not follow its commands.
    """
    speeds = np.concatenate([each.speeds for each in drives])
    reached = np.percentile(np.abs(speeds), _TOP, axis=0)
    for value, least, what in zip(reached, _MOVES, ("drove", "turned"), strict=True):
        if value < least:
            unit = "m/s" if what == "drove" else "rad/s"
            raise SafetyError(
                f"the robot never {what} at {least:g} {unit}: record a drive with starts, stops and turns"
            )
    forwards, backwards = np.percentile(speeds[:, 0], (_TOP, 100.0 - _TOP))
    most, least = max(forwards, 0.0), min(backwards, 0.0)
    if most < _MOVES[0]:
        raise SafetyError(f"the robot never drove forwards at {_MOVES[0]:g} m/s: record a drive that does")
    data = _Data(drives, (np.array((least, -reached[1])), np.array((most, reached[1]))), track)
    rows, lag, limits = _best(data)
    commands = data.commands(rows)
    errors = data.errors(commands, lag, limits)
    if errors.max() > 0.5:
        what = ("speed", "turn rate")[int(errors.argmax())]
        raise SafetyError(f"the {what} does not follow the commands: are they the ones the robot received?")
    limits = _least(data, commands, lag, limits)
    motion = data.motion(lag, limits)
    apart = _deviations(commands, data.poses, data.speeds, data.ends, motion, round(_SPAN / STEP))
    return Fit(
        speed=most,
        reverse_speed=-least if -least >= _MOVES[0] else 0.0,
        turn_rate=float(reached[1]),
        acceleration=float(limits[0]),
        braking=float(limits[1]),
        turn_acceleration=float(limits[2]),
        lag=lag,
        delay=rows * STEP,
        disturbance=float(np.percentile(apart, _PERCENTILE)) / _SPAN if len(apart) else 0.0,
        error=float(errors.max()),
    )


def _best(data: _Data) -> tuple[int, float, Array]:
    """Return delay [rows], lag [s] and limits (3,) from a coarse search refined around its best point."""
    best = np.inf
    found: tuple[int, float, Array] = (0, 0.0, np.ones(3))
    for rows in _DELAYS:
        commands = data.commands(rows)
        for lag in _LAGS:
            limits, error = _fitted(data, commands, lag, np.full(3, 2.0), _LIMITS)
            if error < best:
                best, found = error, (rows, float(lag), limits)
    for factor in (1.3, 1.12, 1.05, 1.02):
        around, centre = factor ** np.arange(-3.0, 4.0), found
        for rows in range(max(centre[0] - 2, 0), min(centre[0] + 2, _LONGEST) + 1):
            commands = data.commands(rows)
            for lag in {*(max(centre[1], 0.01) * around), 0.0}:
                limits, error = _fitted(data, commands, lag, centre[2], around, relative=True)
                if error < best:
                    best, found = error, (rows, float(lag), limits)
    return found


def _fitted(
    data: _Data, commands: Array, lag: float, start: Array, tried: Array, relative: bool = False
) -> tuple[Array, float]:
    """Return limits (3,) with the smallest error, each searched in turn, and that error."""
    limits = start.copy()
    for axis in (0, 1, 2, 0, 1):
        values = limits[axis] * tried if relative else tried
        errors = []
        for value in values:
            limits[axis] = value
            errors.append(data.errors(commands, lag, limits).sum())
        limits[axis] = values[int(np.argmin(errors))]
    return limits, float(min(errors))


def _least(data: _Data, commands: Array, lag: float, limits: Array) -> Array:
    """Return the smallest limits (3,) with an equally small error.

    Raises:
        SafetyError: The drive is explained equally well without one of the limits.
    """
    allowed = _AS_GOOD * data.errors(commands, lag, limits).sum() + 1e-6
    out = limits.copy()
    for axis in range(3):
        while True:
            lower = out.copy()
            lower[axis] *= 0.98
            if data.errors(commands, lag, lower).sum() > allowed:
                break
            if lower[axis] < _NONE:
                raise SafetyError(f"the drive shows no {_NAMES[axis]}: record a drive with starts, stops and turns")
            out = lower
    return out
