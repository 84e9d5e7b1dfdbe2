"""Look-up of a 101 x 101 x 73 value grid against scipy's RegularGridInterpolator, in one process."""

import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from ctrl_rl_core.value_grid import Axis, ValueGrid
from scipy.interpolate import RegularGridInterpolator

SHAPE = (101, 101, 73)
BATCH = 1_000_000
SINGLES = 2_000
REPEATS = 5


def rows() -> list[dict[str, Any]]:
    """Measure; each ratio is this suite's rate over scipy's, both the median of repeats that alternate."""
    random = np.random.default_rng(0)
    axes = tuple(Axis(name, "m", -5.0, 5.0, count) for name, count in zip("xyz", SHAPE, strict=True))
    values = random.uniform(0.0, 20.0, SHAPE).astype(np.float32)
    grid = ValueGrid(values, axes, "time_to_reach", "benchmark", "0" * 64, "random", 0.0)
    peer = RegularGridInterpolator([axis.nodes for axis in axes], values.astype(np.float64))
    states = random.uniform(-5.0, 5.0, (BATCH, 3))
    singles = list(states[:SINGLES])
    against = "scipy RegularGridInterpolator"
    batch, batch_peer = _rates(lambda: grid.value(states), lambda: peer(states), BATCH)
    gradient, _ = _rates(lambda: grid.value_and_gradient(states), lambda: None, BATCH)
    single, single_peer = _rates(lambda: _each(grid.at, singles), lambda: _each(peer, singles), SINGLES)
    return [
        _row("grid look-up, batch of 1e6", batch / 1e6, "M queries/s", against, batch / batch_peer),
        _row("grid look-up with gradient, batch of 1e6", gradient / 1e6, "M queries/s", against, gradient / batch_peer),
        _row("grid look-up, one state", 1e6 / single, "us", against, single / single_peer),
    ]


def _row(name: str, value: float, unit: str, against: str, ratio: float) -> dict[str, Any]:
    return {"name": name, "value": round(value, 3), "unit": unit, "against": against, "ratio": round(ratio, 1)}


def _each(query: Callable[[Any], Any], states: list[Any]) -> None:
    for state in states:
        query(state)


def _rates(ours: Callable[[], Any], theirs: Callable[[], Any], queries: int) -> tuple[float, float]:
    """Queries per second of both, after a warm-up that compiles."""
    ours()
    theirs()
    seconds = [(_seconds(ours), _seconds(theirs)) for _ in range(REPEATS)]
    return queries / statistics.median(s[0] for s in seconds), queries / statistics.median(s[1] for s in seconds)


def _seconds(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


if __name__ == "__main__":
    for row in rows():
        sys.stdout.write("{name}: {value} {unit}, {ratio} x {against}\n".format(**row))
