"""The safety filter's recoverable set, one pass over speeds, beside the viability kernel of the avoid solver."""

import math

import numpy as np

from ctrl_rl_core import Axis, Quantity, System
from ctrl_rl_safety import Growth, RobotModel, obstacles_around, solve_set
from ttr_reward_node import SafetyGame, SafetySolver

MODEL = RobotModel("test", 0.15, 1.0, 1.0, 2.0, 1.5, 1.5, 100.0)
CELL, EVERY = 0.04, 2
NONE = np.empty((0, 2))


def car() -> System:
    """Return the car x, y, theta, v with turn rate and acceleration as controls."""
    states = (
        Quantity("x", "m"),
        Quantity("y", "m"),
        Quantity("theta", "rad", -math.pi, math.pi, periodic=True),
        Quantity("v", "m/s"),
    )
    limits = (("omega", "rad/s", MODEL.turn_rate), ("a", "m/s^2", MODEL.braking))
    controls = tuple(Quantity(name, unit, -most, most) for name, unit, most in limits)
    held = tuple(Quantity(f"d_{each.name}", f"{each.unit}/s", 0.0, 0.0) for each in states)

    def equations(m, _p):  # type: ignore[no-untyped-def]
        return lambda z, u, _d: (z[3] * m.cos(z[2]), z[3] * m.sin(z[2]), u[0], u[1])

    return System("braking_car", states, controls, held, {}, equations)


def test_one_pass_over_speeds_is_the_viability_kernel_of_the_solver() -> None:
    echoes = np.random.default_rng(5).uniform(-1.1, 1.1, (12, 2))
    found = solve_set(obstacles_around(NONE, echoes, NONE, (0.0, 0.0), CELL), MODEL, Growth(0.0))
    ours = found.values[..., ::EVERY, ::EVERY].transpose(3, 2, 1, 0).astype(np.float64)  # x, y, theta, v
    (nodes, _, headings, speeds), width = ours.shape, EVERY * CELL
    axes = (
        Axis("x", "m", found.x, found.x + (nodes - 1) * width, nodes),
        Axis("y", "m", found.y, found.y + (nodes - 1) * width, nodes),
        Axis("theta", "rad", 0.0, 2.0 * math.pi, headings, True),
        Axis("v", "m/s", 0.0, MODEL.speed, speeds),
    )
    margin = ours[:, :, :1, :1]
    kernel = SafetySolver(SafetyGame(car(), axes), interpolation="linear").solve(margin).values
    inner = (slice(7, -7), slice(7, -7))
    away = np.abs(kernel[inner] - ours[inner])
    edge = np.abs(ours[inner]) < 2.0 * width
    assert away[edge].mean() < 0.25 * width
    clear = np.abs(ours[inner]) > width
    assert (np.sign(kernel[inner]) == np.sign(ours[inner]))[clear].mean() > 0.99
