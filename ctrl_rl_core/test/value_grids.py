"""Value grids for tests."""

import numpy as np
from ctrl_rl_core.values.value_grid import Axis
from hypothesis import settings

from ctrl_rl_core import ValueGrid

DIGEST = "0123456789abcdef" * 4
quickly = settings(max_examples=25, deadline=None, derandomize=True)


def make_grid(values, axes, kind="oc_value", **changes) -> ValueGrid:
    fields = {"task": "car_ttr", "task_digest": DIGEST, "solver": "a test", "residual": 1e-3, "notes": {"sweeps": "18"}}
    return ValueGrid(values=np.asarray(values), axes=tuple(axes), kind=kind, **{**fields, **changes})


def random_axes(random: np.random.Generator, n: int, periodic: bool = False) -> list[Axis]:
    lower = random.uniform(-5, 5, n)
    upper = lower + random.uniform(0.5, 8, n)
    counts = random.integers(2, 5 if n > 4 else 8, n)
    wraps = random.random(n) < 0.5 if periodic else np.zeros(n, bool)
    columns = zip(lower, upper, counts, wraps, strict=True)
    return [
        Axis(f"x{k}", "m", *map(float, ends), int(count), bool(wrap)) for k, (*ends, count, wrap) in enumerate(columns)
    ]
