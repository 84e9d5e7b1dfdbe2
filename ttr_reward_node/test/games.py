"""Small systems with closed-form solutions, shared by tests."""

import numpy as np

from ctrl_rl_core import Axis, Interval, Quantity, Region, System
from ttr_reward_node import Clearance, TimeToReachProblem


def _line(math, p):
    del math, p
    return lambda _x, u, d: (u[0] + d[0],)


def _double_integrator(math, p):
    del math, p
    return lambda x, u, d: (x[1] + d[0], u[0] + d[1])


def _plane(math, p):
    del math, p
    return lambda _x, u, d: (u[0] + d[0], u[1] + d[1])


def make(equations, names, controls, disturbance):
    """Return a system with controls in [-1, 1] and a disturbance within +-`disturbance` on the last state."""
    bounds = [0.0] * (len(names) - 1) + [disturbance]
    return System(
        name=equations.__name__.strip("_"),
        states=tuple(Quantity(name, "m") for name in names),
        controls=tuple(Quantity(f"u_{i}", "m/s", -1.0, 1.0) for i in range(controls)),
        disturbances=tuple(Quantity(f"d_{n}", "m/s", -b, b) for n, b in zip(names, bounds, strict=True)),
        parameters={},
        equations=equations,
    )


def line(disturbance=0.0, count=61, centre=0.0, half=0.25):
    """Return the problem x' = u + d, with phi = (|x - centre| - half) / (1 - disturbance)."""
    axes = (Axis("x", "m", -3.0, 3.0, count),)
    target = Region({"x": Interval(centre - half, centre + half)})
    return TimeToReachProblem(make(_line, ("x",), 1, disturbance), axes, target)


def double_integrator(disturbance=0.0, count=81):
    """Return the problem x'' = u + d with target |x| <= 1/2 at any speed."""
    axes = (Axis("x", "m", -3.0, 3.0, count), Axis("v", "m/s", -3.0, 3.0, count))
    target = Region({"x": Interval(-0.5, 0.5)})
    return TimeToReachProblem(make(_double_integrator, ("x", "v"), 1, disturbance), axes, target)


def plane(clearance=None, count=41):
    """Return the problem x' = u, y' = w with a box at the left; `clearance` is a function of x, y."""
    axes = tuple(Axis(name, "m", -2.0, 2.0, count) for name in "xy")
    target = Region({"x": Interval(-1.6, -1.2), "y": Interval(-0.2, 0.2)})
    obstacles = None
    if clearance is not None:
        x, y = np.meshgrid(axes[0].nodes, axes[1].nodes, indexing="ij")
        obstacles = Clearance((0, 1), clearance(x, y).astype(np.float32))
    return TimeToReachProblem(make(_plane, ("x", "y"), 2, 0.0), axes, target, obstacles)
