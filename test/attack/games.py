"""Random games of a control and a disturbance: the solver against plain dynamic programming, and what must hold."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from _attack import Attack
from scipy.ndimage import map_coordinates

from ctrl_rl_core import Axis, Interval, Quantity, Region, System
from ttr_reward_node import Clearance, TimeToReachProblem, solve

NODES = 61
SIDE = 2.0
NAMES = ("x", "y")


def random_problem(random: np.random.Generator) -> TimeToReachProblem:
    """Return a system in which the disturbance multiplies functions of the state, and a box as its target."""
    drift = random.uniform(-0.3, 0.3, (2, 2)) * random.integers(0, 2, (2, 2))
    speed = random.uniform(0.7, 1.2, 2)
    gain = random.uniform(-0.5, 0.5, (2, 2)) * random.integers(0, 2, (2, 2))

    def equations(_math, _p):
        return lambda x, u, d: tuple(
            drift[i, 0] * x[0] + drift[i, 1] * x[1] + speed[i] * u[i] + d[i] * (gain[i, 0] * x[0] + gain[i, 1] * x[1])
            for i in range(2)
        )

    bounds = np.where(gain.any(axis=1), random.uniform(0.1, 0.4, 2), 0.0)  # one that acts on nothing is refused
    system = System(
        name="random",
        states=tuple(Quantity(name, "m") for name in NAMES),
        controls=tuple(Quantity(f"u_{name}", "1", -1.0, 1.0) for name in NAMES),
        disturbances=tuple(Quantity(f"d_{n}", "m/s", -b, b) for n, b in zip(NAMES, bounds, strict=True)),
        parameters={},
        equations=equations,
    )
    centre, half = random.uniform(-1.0, 1.0, 2), random.uniform(0.2, 0.5, 2)
    box = {n: Interval(c - h, c + h) for n, c, h in zip(NAMES, centre.tolist(), half.tolist(), strict=True)}
    axes = tuple(Axis(name, "m", -SIDE, SIDE, NODES) for name in NAMES)
    return TimeToReachProblem(system, axes, Region(box))


def plain_times(problem: TimeToReachProblem) -> np.ndarray:
    """Return times to reach by value iteration over short steps, which takes no axis for independent of another."""
    nodes = np.stack(np.meshgrid(*(axis.nodes for axis in problem.axes), indexing="ij"), axis=-1)
    spacing = problem.axes[0].spacing
    dt, far = 0.75 * spacing, 1e3
    inside = problem.in_target()
    pairs = list(product(problem.system.disturbance_samples(2), problem.system.control_samples(3)))
    ends = [problem.system.step(nodes, u, d, dt=dt) for d, u in pairs]
    times = np.where(inside, 0.0, far)
    for _ in range(800):
        found = []
        for end in ends:
            at = np.moveaxis((end + SIDE) / spacing, -1, 0)
            value = dt + map_coordinates(times, at, order=1, mode="nearest")
            left = (np.abs(end) > SIDE + 1e-9).any(axis=-1)
            found.append(np.where(left, far, value))
        shaped = np.array(found).reshape(len(problem.system.disturbance_samples(2)), -1, *times.shape)
        new = np.where(inside, 0.0, np.minimum(shaped.min(axis=1).max(axis=0), times))
        if np.abs(new - times).max() < 1e-4:
            break
        times = new
    return np.where(times > 0.5 * far, np.inf, times)


def against_plain(random: np.random.Generator, _folder: Path) -> None:
    """Compare the solver with plain dynamic programming on the same nodes."""
    problem = random_problem(random)
    ours, plain = solve(problem).grid.values, plain_times(problem)
    reached = float(np.mean(np.isfinite(ours))), float(np.mean(np.isfinite(plain)))
    assert abs(reached[0] - reached[1]) <= 0.1, f"reachable {reached[0]:.2f}, plain {reached[1]:.2f}"
    both = np.isfinite(ours) & np.isfinite(plain) & (plain > 0.0)
    if both.sum() > 50:
        gap = np.median(np.abs(ours - plain)[both]) / np.median(plain[both])
        assert gap <= 0.1, f"times differ by {gap:.0%}"


def order(random: np.random.Generator, _folder: Path) -> None:
    """Compare a game with an easier and with harder ones."""
    problem = random_problem(random)
    base = solve(problem).grid.values
    wider = {name: Interval(low - 0.15, high + 0.15) for name, (low, high) in problem.target.intervals.items()}
    not_longer(solve(replace(problem, target=Region(wider))).grid.values, base, "a larger target prolongs")
    x, y = np.meshgrid(*(axis.nodes for axis in problem.axes), indexing="ij")
    at = random.uniform(-1.5, 1.5, 2)
    clearance = (np.maximum(np.abs(x - at[0]), np.abs(y - at[1])) - 0.3).astype(np.float32)
    not_longer(
        base, solve(replace(problem, clearance=Clearance((0, 1), clearance))).grid.values, "an obstacle shortens"
    )
    stronger = tuple(replace(d, lower=1.5 * d.lower, upper=1.5 * d.upper) for d in problem.system.disturbances)
    harder = replace(problem, system=replace(problem.system, disturbances=stronger))
    not_longer(base, solve(harder).grid.values, "a stronger disturbance shortens")


def not_longer(easier: np.ndarray, harder: np.ndarray, words: str) -> None:
    """Check that times nowhere grow, to what a cell and the curvature of the scheme make of an edge."""
    lost = np.isfinite(harder) & ~np.isfinite(easier)
    assert lost.mean() <= 0.02, f"{words}: {lost.mean():.1%} of the nodes are lost"
    both = np.isfinite(easier) & np.isfinite(harder)
    worse = (easier - harder)[both] > 0.15
    assert worse.mean() <= 0.02, f"{words}: the time of {worse.mean():.1%} of the nodes"


ATTACKS = (
    Attack(
        "games-plain",
        "Times to reach are those of plain dynamic programming, also where a disturbance multiplies the state.",
        against_plain,
        limit_s=240.0,
    ),
    Attack(
        "games-order",
        "A larger target never prolongs; an obstacle or a stronger disturbance never shortens.",
        order,
        limit_s=240.0,
    ),
)
