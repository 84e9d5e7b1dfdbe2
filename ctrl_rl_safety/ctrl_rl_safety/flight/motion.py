"""Planar quadrotor dynamics, clearance to shapes, and escape thrusts. Compiled code."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_core import Box, Shape
from ctrl_rl_safety.models.quadrotor_model import QuadrotorModel

Array = NDArray[np.float64]
State = tuple[float, float, float, float, float, float]

_BELOW_LIMIT = 0.2  # margin of the tilt limit in an escape [rad], because the pitch overshoots slightly
_OF_ALL = 0.85  # fraction of the possible acceleration used in an escape; the rest rotates the body
_BRAKING_S = 0.25  # time constant of the speed when braking, about the time needed to tilt
_SIDEWAYS = 0.2  # fraction of the minimum thrust below which a sideways force does not change the side of the tilt


class Craft(NamedTuple):
    """A `QuadrotorModel` for compiled code, with the same names, and the limits of escapes.

    Attributes:
        half_length: Half of the body's length [m].
        half_height: Half of the body's height [m].
        tilt: Maximum pitch in an escape [rad].
        aside: Maximum sideways acceleration in an escape [m/s^2].
        up: Maximum upward acceleration in an escape [m/s^2].
        down: Maximum downward acceleration in an escape [m/s^2].
        tick: Hold time of the thrusts [s].
    """

    mass: float
    gravity: float
    drag: float
    spin_drag: float
    inertia: float
    arm: float
    least: float
    most: float
    tilt_limit: float
    half_length: float
    half_height: float
    tilt: float
    aside: float
    up: float
    down: float
    tick: float
    disturbance: float


def craft_of(model: QuadrotorModel, tick: float) -> Craft:
    """Convert a model for compiled code, with thrusts held for `tick` seconds."""
    tilt = model.tilt_limit - _BELOW_LIMIT
    weight, most, least = model.mass * model.gravity, 2.0 * model.most, 2.0 * model.least
    aside = min(math.sqrt(most**2 - weight**2) / model.mass, model.gravity * math.tan(tilt))
    up, down = most / model.mass - model.gravity, model.gravity - least * math.cos(tilt) / model.mass
    return Craft(
        *(model.mass, model.gravity, model.drag, model.spin_drag, model.inertia, model.arm),
        *(model.least, model.most, model.tilt_limit, 0.5 * model.length, 0.5 * model.height),
        *(tilt, _OF_ALL * aside, _OF_ALL * up, _OF_ALL * down, tick, model.disturbance),
    )


def shape_rows(shapes: Sequence[Shape]) -> Array:
    """Convert shapes to rows (k, 7): centre, cosine and sine of the angle, half side lengths, and radius of a disc."""
    rows = [
        (*shape.centre, math.cos(shape.angle), math.sin(shape.angle), 0.5 * shape.size[0], 0.5 * shape.size[1], 0.0)
        if isinstance(shape, Box)
        else (*shape.centre, 1.0, 0.0, 0.0, 0.0, shape.radius)
        for shape in shapes
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 7)


@njit
def room_at(craft: Any, shapes: Array, x: float, z: float, psi: float) -> float:
    """Return a lower bound of the body's distance to all shapes and of the tips' distance to the tilt limit [m].

    For a box, the bound is the largest gap along the sides of both rectangles (separating axes): exact except when two
    corners face each other, and negative on overlap.
    """
    c, s, length, height = math.cos(psi), math.sin(psi), craft.half_length, craft.half_height
    least = (craft.tilt_limit - abs(psi)) * length
    for k in range(len(shapes)):
        dx, dz = shapes[k, 0] - x, shapes[k, 1] - z
        along, across = abs(c * dx - s * dz) - length, abs(s * dx + c * dz) - height
        if shapes[k, 6] > 0.0:
            gap = math.hypot(max(along, 0.0), max(across, 0.0)) + min(max(along, across), 0.0) - shapes[k, 6]
        else:
            bc, bs, ha, hb = shapes[k, 2], shapes[k, 3], shapes[k, 4], shapes[k, 5]
            same, crossed = abs(c * bc - s * bs), abs(s * bc + c * bs)  # of the angle between the sides
            gap = max(
                max(along - ha * same - hb * crossed, across - ha * crossed - hb * same),
                max(
                    abs(bc * dx + bs * dz) - ha - length * same - height * crossed,
                    abs(bc * dz - bs * dx) - hb - length * crossed - height * same,
                ),
            )
        least = min(least, gap)
    return least


@njit
def _rates(craft: Any, state: State, push: float, turn: float) -> Any:
    _, v_x, _, v_z, psi, omega = state
    return (
        (push * math.sin(psi) - craft.drag * v_x) / craft.mass,
        (push * math.cos(psi) - craft.drag * v_z) / craft.mass - craft.gravity,
        (craft.arm * turn - craft.spin_drag * omega) / craft.inertia,
    )


@njit
def moved(craft: Any, state: State, t_1: float, t_2: float, seconds: float) -> Any:
    """Return the state after holding thrusts for a short time (midpoint rule)."""
    x, v_x, z, v_z, psi, omega = state
    half = 0.5 * seconds
    a, b, c = _rates(craft, state, t_1 + t_2, t_1 - t_2)
    middle = (x + half * v_x, v_x + half * a, z + half * v_z, v_z + half * b, psi + half * omega, omega + half * c)
    a, b, c = _rates(craft, middle, t_1 + t_2, t_1 - t_2)
    return (
        x + seconds * middle[1],
        v_x + seconds * a,
        z + seconds * middle[3],
        v_z + seconds * b,
        psi + seconds * middle[5],
        omega + seconds * c,
    )


@njit
def escape_thrusts(craft: Any, state: State, angle: float, push_for: float) -> Any:
    """Return the thrusts of an escape: full acceleration in one direction for a time, then braking.

    Args:
        craft: Constants of the quadrotor, a `Craft`.
        state: Current state.
        angle: Direction, from x towards z [rad].
        push_for: Remaining duration of the acceleration [s]; 0 to brake.
    """
    _, v_x, _, v_z, psi, omega = state
    if push_for > 0.5 * craft.tick:
        a_x, a_z = craft.aside * math.cos(angle), math.sin(angle)
        a_z *= craft.up if a_z > 0.0 else craft.down
    else:
        a_x = min(max(-v_x / _BRAKING_S, -craft.aside), craft.aside)
        a_z = min(max(-v_z / _BRAKING_S, -craft.down), craft.up)
    f_x = craft.mass * a_x + craft.drag * v_x
    f_z = craft.mass * (a_z + craft.gravity) + craft.drag * v_z
    least, most = 2.0 * craft.least, 2.0 * craft.most
    f_z = min(f_z, most)
    aside = math.sqrt(most * most - f_z * f_z) if f_z > -most else 0.0
    f_x = min(max(f_x, -aside), aside)  # lift takes precedence
    if math.hypot(f_x, f_z) >= least and f_z > 0.0:
        wanted = math.atan2(f_x, f_z)
    else:  # the minimum thrust lifts too much unless tilted to either side
        side = psi if abs(f_x) < _SIDEWAYS * least else f_x
        tilt = math.acos(min(max(f_z / least, 0.0), 1.0)) if least > 0.0 else 0.5 * math.pi
        wanted = math.copysign(tilt, side) if least > 0.0 or f_x != 0.0 else 0.0
    wanted = min(max(wanted, -craft.tilt), craft.tilt)
    push = f_x * math.sin(psi) + f_z * math.cos(psi)
    error, limit = wanted - psi, (craft.most - craft.least) * craft.arm / craft.inertia
    rate = math.copysign(min(0.4 * abs(error) / craft.tick, math.sqrt(1.2 * limit * abs(error))), error)
    turn = (craft.inertia * (rate - omega) / craft.tick + craft.spin_drag * omega) / craft.arm
    turn = min(max(turn, craft.least - craft.most), craft.most - craft.least)
    push = min(max(push, least + abs(turn)), most - abs(turn))
    return 0.5 * (push + turn), 0.5 * (push - turn)
