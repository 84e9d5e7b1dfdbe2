"""The states around the robot from which it can still stop without contact.

Passive motion safety (Macek et al. 2009; Bouraine, Fraichard and Salhi 2012): a state is recoverable if some manoeuvre
stops the robot before any contact. For a disc with a bounded turn rate, full braking with free turning is sufficient: a
robot that stays clear forever follows a path, and can follow the same path while braking, because the curvature omega /
v stays within the bound as v falls. The set is therefore the viability kernel of the obstacles' complement (the
infinite-horizon avoid set), and a single pass over the speeds, from zero upwards, computes it without iteration:

    V_0 = l,    V_j(x, y, theta) = min(l, max over omega of min(l on the way, V_{j-1}(x+, y+, theta+)))

l is the distance to the inflated echoes minus the radius. A reverse speed equals a forward speed at theta + pi. A
rectangle is covered by a row of discs; the proof does not hold for it, because its rotation needs room.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_safety.models.growth import Growth, fixed_growth, moving_growth, standing_growth
from ctrl_rl_safety.models.motion import STANDS, motion_of, next_speeds
from ctrl_rl_safety.models.robot_model import RobotModel
from ctrl_rl_safety.sets.disc_row import HEADINGS, discs_of, margins_of_row
from ctrl_rl_safety.sets.distance_field import Obstacles

Array = NDArray[np.float64]
Field = NDArray[np.float32]

LEVELS = 5
"""Number of speeds above zero."""
TURNS = 7
"""Number of turn rates to try, from one side to the other."""
_FINE = 0.005
"""Time step of the braking between two levels [s]."""


class Ladder(NamedTuple):
    """Braking steps from each speed to the next lower one.

    Attributes:
        speeds: Speeds from zero to the maximum (LEVELS + 1,) [m/s].
        times: Time from each speed to the next lower one (LEVELS + 1,) [s]; zero for the first.
        ways: Distance driven in that time (LEVELS + 1,) [m].
    """

    speeds: Array
    times: Array
    ways: Array

    def time_to_stand(self, v: float) -> float:
        """Return the time of full braking from a speed [m/s] to rest."""
        return float(np.interp(abs(v), self.speeds, np.cumsum(self.times)))


def brake_ladder(model: RobotModel) -> Ladder:
    """Return times and distances of full braking; with a lag, motion below `STANDS` counts as instantaneous."""
    top = max(model.speed, model.reverse_speed)
    speeds = np.linspace(0.0, top, LEVELS + 1)
    times, ways = np.zeros(LEVELS + 1), np.zeros(LEVELS + 1)
    motion, v = motion_of(model, _FINE), top
    for level in range(LEVELS, 0, -1):
        while v > max(speeds[level - 1], STANDS):
            slower, _ = next_speeds(v, 0.0, 0.0, 0.0, motion)
            part = 1.0
            if slower < speeds[level - 1]:
                part = (v - speeds[level - 1]) / (v - slower)
                slower = speeds[level - 1]
            times[level] += part * _FINE
            ways[level] += part * _FINE * 0.5 * (v + slower)
            v = slower
    ways[1] += model.stopping_distance(min(v, STANDS))
    return Ladder(speeds, times, ways)


@dataclass(frozen=True)
class RecoverableSet:
    """Values on the grid of the obstacles; a state is recoverable if its value is non-negative.

    Attributes:
        values: Margins (LEVELS + 1, HEADINGS, rows, columns) [m].
        x: Position of the first column [m].
        y: Position of the first row [m].
        cell: Node spacing [m].
        top: Speed of the last level [m/s].
        stamp: Time of the scan for which the set was solved [s], on the caller's clock.
    """

    values: Field
    x: float
    y: float
    cell: float
    top: float
    stamp: float = 0.0

    def value(self, state: Array) -> float:
        """Return the margin at a state x, y, theta, v, ... in the obstacles' frame [m]; NaN off the grid."""
        x, y, theta, v = (float(each) for each in state[:4])
        return float(value_at(self.values, self.x, self.y, self.cell, self.top, x, y, theta, v))

    def slice_at(self, theta: float, v: float) -> Field:
        """Return the margins (rows, columns) at a heading [rad] and speed [m/s], from the nearest nodes."""
        heading = theta if v >= 0.0 else theta + math.pi
        level = round(min(abs(v) / self.top, 1.0) * LEVELS)
        column = round(heading / (2.0 * math.pi) * HEADINGS) % HEADINGS
        return self.values[level, column]


def _rise(
    below: Field,
    here: Field,
    length: float,
    time: float,
    turn_rate: float,
    cell: float,
    out: Field,
) -> None:
    """Compute the values at a speed (HEADINGS, rows, columns) from those at the next lower speed.

    Args:
        below: Values at the next lower speed (HEADINGS, rows + 2 pad, columns + 2 pad), padded at its edges.
        here: Margins of positions at this speed, with the same padding (1 or HEADINGS, rows + 2 pad, columns + 2 pad).
        length: Distance driven between the two speeds [m].
        time: Time between them [s].
        turn_rate: Maximum turn rate [rad/s].
        cell: Node spacing [m].
        out: Values at this speed (HEADINGS, rows, columns).
    """
    rows, columns = out.shape[1], out.shape[2]
    pad = (here.shape[1] - rows) // 2
    width = 2.0 * math.pi / HEADINGS
    between = max(1, math.ceil(length / cell))
    worst = np.empty((rows, columns), np.float32)
    for heading in range(HEADINGS):
        theta = heading * width
        out[heading] = -np.float32(np.inf)
        for k in range(TURNS):
            omega = turn_rate * (2.0 * k / (TURNS - 1) - 1.0)
            turn = omega * time
            there = theta + turn
            place = there / width
            first = math.floor(place)
            second_part = np.float32(place - first)
            low, high = first % HEADINGS, (first + 1) % HEADINGS
            worst[:] = np.float32(np.inf)
            for part in range(1, between + 1):
                share = part / between
                half = 0.5 * turn * share
                chord = length * share * (math.sin(half) / half if abs(half) > 1e-9 else 1.0) / cell
                dx, dy = chord * math.cos(theta + half), chord * math.sin(theta + half)
                shift_x, shift_y = math.floor(dx), math.floor(dy)
                fx, fy = np.float32(dx - shift_x), np.float32(dy - shift_y)
                a, b = (np.float32(1.0) - fy) * (np.float32(1.0) - fx), (np.float32(1.0) - fy) * fx
                c, d = fy * (np.float32(1.0) - fx), fy * fx
                if part < between:
                    faced = here[round((theta + 2.0 * half) / width) % HEADINGS % len(here)]
                    for row in range(rows):
                        lower, upper = faced[row + pad + shift_y], faced[row + pad + shift_y + 1]
                        for column in range(columns):
                            at = column + pad + shift_x
                            found = a * lower[at] + b * lower[at + 1] + c * upper[at] + d * upper[at + 1]
                            worst[row, column] = min(worst[row, column], found)
                else:
                    one = np.float32(1.0) - second_part
                    for row in range(rows):
                        lower, upper = below[low, row + pad + shift_y], below[low, row + pad + shift_y + 1]
                        left, right = below[high, row + pad + shift_y], below[high, row + pad + shift_y + 1]
                        for column in range(columns):
                            at = column + pad + shift_x
                            found = one * (a * lower[at] + b * lower[at + 1] + c * upper[at] + d * upper[at + 1])
                            found += second_part * (a * left[at] + b * left[at + 1] + c * right[at] + d * right[at + 1])
                            found = min(found, worst[row, column])
                            out[heading, row, column] = max(out[heading, row, column], found)
        faced = here[heading % len(here)]
        for row in range(rows):
            for column in range(columns):
                out[heading, row, column] = min(out[heading, row, column], faced[row + pad, column + pad])


_rise_without_gil = cached_njit(_rise, nogil=True)
"""Version without the GIL, because solves run in a thread while another one answers commands."""


@cached_njit
def _growths(times: Array, growth: Any) -> Array:
    out = np.empty((len(times), 3))
    for k in range(len(times)):
        out[k, 0] = fixed_growth(times[k], growth)
        out[k, 1], out[k, 2] = standing_growth(times[k], growth), moving_growth(times[k], growth)
    return out


def solve_set(
    obstacles: Obstacles,
    model: RobotModel,
    growth: Growth,
    age: float = 0.0,
    v: float | None = None,
    commit: float = 0.0,
    stamp: float = 0.0,
) -> RecoverableSet:
    """Compute the recoverable set around the robot.

    Args:
        obstacles: Echoes with their distances on the grid.
        model: Constants of the robot.
        growth: Bounds of motion.
        age: Age of the echoes [s].
        v: Present speed [m/s], which bounds the time until a lower one is reached; None for the maximum.
        commit: Time until a new command takes effect [s].
        stamp: Time stamp of the set [s].
    """
    ladder = brake_ladder(model)
    top = float(ladder.speeds[-1])
    fastest = top if v is None else min(abs(v) + model.acceleration * commit, top)
    to_stand = np.cumsum(ladder.times)
    reached = np.maximum(ladder.time_to_stand(fastest) - to_stand, 0.0) + commit + age
    growths = _growths(reached, growth)
    offsets, radius = discs_of(model)
    room = radius + model.range_error
    pad = math.ceil(float(ladder.ways.max()) / obstacles.cell) + 2
    values = np.empty((LEVELS + 1, HEADINGS, *obstacles.to_standing.shape), np.float32)
    for level in range(LEVELS + 1):
        fields = obstacles.to_fixed, obstacles.to_standing, obstacles.to_moving
        grown = [field - np.float32(growth) for field, growth in zip(fields, growths[level], strict=True)]
        here = np.pad(np.minimum.reduce(grown) - np.float32(room), pad, mode="edge")
        here = here[None] if len(offsets) == 1 else margins_of_row(here, offsets, obstacles.cell)
        if level == 0:
            values[0] = here[:, pad:-pad, pad:-pad]
            continue
        below = np.pad(values[level - 1], ((0, 0), (pad, pad), (pad, pad)), mode="edge")
        _rise_without_gil(
            below,
            here,
            float(ladder.ways[level]),
            float(ladder.times[level]),
            model.turn_rate,
            obstacles.cell,
            values[level],
        )
    return RecoverableSet(values, obstacles.x, obstacles.y, obstacles.cell, top, stamp)


@njit(inline="always")
def value_at(
    values: Any, x0: float, y0: float, cell: float, top: float, x: float, y: float, theta: float, v: float
) -> float:
    """Return the value at a state by linear interpolation; NaN off the grid."""
    rows, columns = values.shape[2], values.shape[3]
    column, row = (x - x0) / cell, (y - y0) / cell
    if not (0.0 <= column <= columns - 1 and 0.0 <= row <= rows - 1):
        return math.nan
    if v < 0.0:
        theta += math.pi
    level = min(abs(v) / top, 1.0) * LEVELS
    turn = theta / (2.0 * math.pi) * HEADINGS
    l0, j0, i0 = min(int(level), LEVELS - 1), min(int(column), columns - 2), min(int(row), rows - 2)
    h0 = math.floor(turn)
    fl, fh, fj, fi = level - l0, turn - h0, column - j0, row - i0
    out = 0.0
    for a in range(2):
        for b in range(2):
            weight = (fl if a else 1.0 - fl) * (fh if b else 1.0 - fh)
            plane = values[l0 + a, (h0 + b) % HEADINGS]
            out += weight * (
                (1.0 - fi) * ((1.0 - fj) * plane[i0, j0] + fj * plane[i0, j0 + 1])
                + fi * ((1.0 - fj) * plane[i0 + 1, j0] + fj * plane[i0 + 1, j0 + 1])
            )
    return out
