"""Look-up in a value grid, many states at once and one at a time, against scipy's RegularGridInterpolator."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from _common import Row, row
from scipy.interpolate import RegularGridInterpolator

from ctrl_rl_core import Axis, ValueGrid

STATES = 200_000
SINGLES = 20_000
REPEATS = 5


def rows() -> list[Row]:
    """Return rates of value, and of value with gradient; each ratio is to scipy's rate for the same states."""
    axes = (
        Axis("x", "m", -5.0, 5.0, 101),
        Axis("y", "m", -5.0, 5.0, 101),
        Axis("theta", "rad", -np.pi, np.pi, 73),
    )
    random = np.random.default_rng(0)
    values = random.uniform(0.0, 20.0, (101, 101, 73))
    grid = ValueGrid(values, axes, "time_to_reach", "benchmark", "0" * 64, "none", 0.0)
    peer = RegularGridInterpolator([axis.nodes for axis in axes], values)
    states = random.uniform([-5.0, -5.0, -np.pi], [5.0, 5.0, np.pi], (STATES, 3))
    assert np.allclose(grid.value(states), peer(states), atol=1e-9)

    batch = STATES / _seconds(lambda: grid.value(states))
    gradient = STATES / _seconds(lambda: grid.value_and_gradient(states))
    peer_batch = STATES / _seconds(lambda: peer(states))
    singles = list(states[:SINGLES])
    single = SINGLES / _seconds(lambda: [grid.at(state) for state in singles])
    some = singles[: SINGLES // 20]
    peer_single = len(some) / _seconds(lambda: [peer(state) for state in some])
    name = "scipy RegularGridInterpolator"
    return [
        row(
            "grid look-up, many states",
            1e-6 * batch,
            "M states/s",
            f"{name}, {1e-6 * peer_batch:.3g}",
            batch / peer_batch,
        ),
        row(
            "grid look-up with gradient, many states",
            1e-6 * gradient,
            "M states/s",
            f"{name} (value only), {1e-6 * peer_batch:.3g}",
            gradient / peer_batch,
        ),
        row("grid look-up, one state", 1e6 / single, "us", f"{name}, {1e6 / peer_single:.3g} us", single / peer_single),
    ]


def _seconds(work: Callable[[], object]) -> float:
    """Return the least CPU time of some repeats [s], after one that compiles."""
    work()
    times = []
    for _ in range(REPEATS):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return min(times)


if __name__ == "__main__":
    print(*rows(), sep="\n")
