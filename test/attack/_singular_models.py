"""Random models of a user's own whose equations have no derivative, or no value, somewhere that a trajectory begins."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ctrl_rl_core import SYSTEM_MODELS, Quantity, SystemModel, load_navigation_task
from oc_baseline_node import OptimalControlProblem, formulate

Term = Callable[[Any, Any, float], Any]
"""A term of a rate from the namespace of sqrt, sin ..., a component of the state, and a number from 0 to 1."""
TERMS: dict[str, Term] = {
    "quadratic drag by a root": lambda m, v, c: -c * m.sqrt(v * v) * v,
    "quadratic drag by fabs": lambda m, v, c: -c * m.fabs(v) * v,
    "root": lambda m, v, c: -c * m.sqrt(v),
    "root of a distance": lambda m, v, c: -c * m.sqrt(m.fabs(v)),
    "root beside zero": lambda m, v, c: -c * m.sqrt(v + 1e-12),
    "power 1.5": lambda m, v, c: -c * m.fabs(v) ** 1.5,
    "power 1/3": lambda _, v, c: -c * v ** (1.0 / 3.0),
    "power -1/2": lambda _, v, c: -c * v**-0.5,
    "power 0.7 of a square": lambda _, v, c: -c * (v * v) ** 0.7,
    "its own power": lambda _, v, c: -c * v**v,
    "reciprocal": lambda _, v, c: c / v,
    "reciprocal square": lambda _, v, c: -c * v**-2,
    "sine over angle": lambda m, v, c: -c * m.sin(v) / v,
    "direction": lambda m, v, c: -c * v / m.sqrt(v * v),
    "logarithm": lambda m, v, c: -c * m.log(v),
    "logarithm of a distance": lambda m, v, c: -c * m.log(m.fabs(v)),
    "x log x": lambda m, v, c: -c * v * m.log(v * v),
    "logarithm of 1 + v": lambda m, v, c: -c * m.log1p(v),
    "arc sine at its edge": lambda m, v, c: -c * m.asin(1.0 - v * v),
    "arc sine of a limit": lambda m, v, c: -c * m.asin(v),
    "arc cosine at its edge": lambda m, v, c: -c * m.acos(1.0 - m.fabs(v)),
    "hyperbolic arc cosine": lambda m, v, c: -c * m.acosh(1.0 + v * v),
    "hyperbolic arc tangent": lambda m, v, c: -c * m.atanh(v),
    "arc tangent of two": lambda m, v, c: -c * m.atan2(v, v * c),
    "arc tangent of zero": lambda m, v, c: -c * m.atan2(v, 0.0 * v),
    "length": lambda m, v, c: -c * m.hypot(v, c * v) * v,
    "tangent near its pole": lambda m, v, c: -c * m.tan(1.5 * v),
    "exponential": lambda m, v, c: -c * m.exp(60.0 * v),
    "exponential of an exponential": lambda m, v, c: -c * m.exp(m.exp(8.0 * v)),
    "ninth power": lambda _, v, c: -c * v**9,
    "step": lambda m, v, c: -c * m.sign(v),
    "whole part": lambda m, v, c: -c * m.floor(8.0 * v),
    "larger of two": lambda m, v, c: -c * m.fmax(v, 0.0),
    "not a number": lambda _, _v, c: c * float("nan"),
    "not a number times": lambda _, v, c: c * v * float("nan"),
    "infinite": lambda _, v, c: c * float("inf") * v,
    "zero over zero": lambda _, v, c: c * (v - v) / (v - v),
}
"""Terms by name. At v = 0, where a robot rests, nearly all have a derivative that is no number."""
_CONTROLS = {"a_x": "-1 .. 1 m/s^2", "a_y": "-1 .. 1 m/s^2"}
_RESTS = (0.0, 1.0, -1.0, 1e-12, 0.5)
"""Values of a component at which terms are singular, or not."""


Place = tuple[str, int, int, float]
"""Name of a term, the rate that it is added to, the component that it takes, and its size."""


def point_mass_with(places: Sequence[Place]) -> SystemModel:
    """Return a point mass of the plane, driven by its acceleration, with terms in its rates."""

    def equations(math: Any, _parameters: Any) -> Any:
        def f(x: Any, u: Any, d: Any) -> tuple[Any, ...]:
            rates = [x[2] + d[0], x[3] + d[1], u[0] + d[2], u[1] + d[3]]
            for name, row, column, size in places:
                rates[row] = rates[row] + TERMS[name](math, x[column], size)
            return tuple(rates)

        return f

    return SystemModel(
        states=(Quantity("x", "m"), Quantity("y", "m"), Quantity("v_x", "m/s", -2, 2), Quantity("v_y", "m/s", -2, 2)),
        controls=(Quantity("a_x", "m/s^2", -1, 1), Quantity("a_y", "m/s^2", -1, 1)),
        parameters=(),
        equations=equations,
    )


def make_problem(
    places: Sequence[Place],
    folder: Path,
    goal: float = 2.0,
    horizon: int = 20,
    gamma: float = 1.0,
    obstacle: bool = False,
    controls: Mapping[str, str] = _CONTROLS,
) -> OptimalControlProblem:
    """Return the problem of a point mass with terms; its task is written to random_model.yaml.

    Args:
        places: Terms and where they stand.
        folder: Folder of the task file.
        goal: x of the goal's middle [m].
        horizon: Number of steps.
        gamma: Growth of the state cost per step.
        obstacle: Whether a box stands in the way.
        controls: Bounds of the controls in the task's optimal control problem.
    """
    SYSTEM_MODELS["random_model"] = point_mass_with(places)
    content = {
        "name": "random_model",
        "kind": "navigation",
        "about": "A point mass with terms that are singular somewhere.",
        "source": "random",
        "system": {"model": "random_model"},
        "robot": {"body": "model", "footprint": "0.2 m", "commands": dict(_CONTROLS)},
        "arena": {"x": "-5 .. 5 m", "y": "-5 .. 5 m", "wall_thickness": "0.2 m"},
        "start": {"x": "-0.4 .. 0.4 m", "y": "-0.2 .. 0.2 m", "v_x": "0 m/s", "v_y": "0 m/s"},
        "goal": {"disc": {"centre": f"({goal}, 0.5) m", "radius": "0.4 m"}},
        "obstacles": [{"box": {"centre": "(1.0, 0.3) m", "size": "(0.5, 0.5) m"}}] if obstacle else [],
        "episode": {"steps": 200, "time_step": "0.2 s"},
        "rewards": {"goal": 1000, "collision": -400},
        "lidar": {"beams": 8, "field": "-90 .. 90 deg", "placement": "centres", "range": "0.1 .. 10 m", "rate": "5 Hz"},
        "optimal_control": {
            "horizon": horizon,
            "time_step": "0.2 s",
            "gamma": gamma,
            "discount": 0.95,
            "state_weight": 1.0,
            "control_weight": 0.01,
            "clearance": "0.25 m",
            "trajectories": 4,
            "controls": dict(controls),
            "bounds": {"x": "-5 .. 5 m", "y": "-5 .. 5 m"},
        },
    }
    file = folder / "random_model.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return formulate(load_navigation_task(str(file)))


def random_problem(random: np.random.Generator, folder: Path) -> tuple[OptimalControlProblem, np.ndarray, str]:
    """Return the problem of a model with one to three terms, a start at rest or at an edge, and the terms' names."""
    names = random.choice(list(TERMS), size=random.integers(1, 4), replace=False).tolist()
    places = [(name, int(random.integers(4)), int(random.integers(4)), random.uniform(0.1, 0.6)) for name in names]
    goal, obstacle = random.uniform(1.0, 3.0), bool(random.uniform() < 0.3)
    horizon, gamma = int(random.integers(10, 25)), float(random.choice((1.0, 1.1)))
    start = np.array([float(random.choice(_RESTS)) if random.uniform() < 0.7 else 0.0 for _ in range(4)])
    return make_problem(places, folder, goal, horizon, gamma, obstacle), start, ", ".join(names)
