"""Checks of a system's equations when a problem is created: they are evaluated on states of its grid, all at once.

The solvers pass arrays of states to the equations. So equations must not branch, may use only elementwise functions,
and must give a finite derivative at every node.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Axis, System
from ttr_reward_node.errors import TimeToReachError

Array = NDArray[np.float64]
_RANDOM = 128  # number of random nodes
_EACH = 4  # number of states per node of each axis, with random nodes of the other axes
_MOST_CORNERS = 729  # maximum number of states that combine the ends and the middle of each axis
_ONE_BY_ONE = 8  # number of states also evaluated one at a time
_SAME = 1e-9  # relative tolerance for equal derivatives
_SAME_TURN = 1e-2  # the same for derivatives one period on, relative to the largest: 57.3 degrees are nearly a radian
_FUNCTIONS = "sin cos tan asin acos atan atan2 sinh cosh tanh exp log sqrt hypot floor ceil fabs fmod copysign"
_BRANCH = "a branch is arithmetic: (x[0] > 1) * a + (x[0] <= 1) * b"


def check_names(system: System) -> None:
    """Check that component names are unique and that there is one disturbance per state.

    Raises:
        TimeToReachError: A name is duplicated (named), or the number of disturbances is wrong.
    """
    names = [quantity.name for quantity in (*system.states, *system.controls)]
    for name in names:
        if names.count(name) > 1:
            raise TimeToReachError(f"{system.name}: '{name}' names two states or controls: give each its own name")
    if len(system.disturbances) != len(system.states):
        raise TimeToReachError(
            f"{system.name} has {len(system.disturbances)} disturbances and {len(system.states)} states: "
            "give one for each state, in [0, 0] where there is none"
        )


def check_equations(system: System, axes: Sequence[Axis]) -> Array:
    """Check that the solvers can evaluate the equations everywhere on the grid.

    Args:
        system: System with valid names and bounds.
        axes: Axis of each state.

    Returns:
        Largest absolute derivative found for each state (n,).

    Raises:
        TimeToReachError: The equations are not callable, raise an exception, change what they are given, return a
            number of derivatives other than the number of states or values that are not finite real numbers, give
            different results for one state and for many, or after one period of a periodic state. Names the state and
            the remedy.
    """
    states, u, d = _grid_states(axes), _samples(system.control_bounds), _samples(system.disturbance_bounds)
    f = _run(system, lambda: system.equations(np, system.parameters), "cannot be made")
    if not callable(f):
        raise TimeToReachError(
            f"{system.name}: equations(math, parameters) return {_short(f)}: let them return a function f(x, u, d)"
        )
    rates = np.stack([_rates(system, f, states, *pair) for pair in product(u, d)])
    _check_finite(system, states, rates, list(product(u, d)))
    _check_one_by_one(system, f, states, rates, list(product(u, d)))
    _check_periods(system, axes, f, states, rates, list(product(u, d)))
    return np.asarray(np.abs(rates).max(axis=(0, 1)))


def _grid_states(axes: Sequence[Axis]) -> Array:
    """Return nodes (k, n): every node of every axis, combinations of ends and middles, and random nodes."""
    random = np.random.default_rng(0)
    nodes = [axis.nodes for axis in axes]

    def draw(count: int) -> Array:
        return np.stack([random.choice(each, count) for each in nodes], axis=-1)

    parts = [draw(_RANDOM)]
    for k, each in enumerate(nodes):
        some = draw(_EACH * len(each))
        some[:, k] = np.repeat(each, _EACH)
        parts.append(some)
    # A singularity is most likely at zero or in the middle.
    ends = [(each[0], each[np.argmin(np.abs(each))], each[-1]) for each in nodes]
    middles = [(each[0], each[len(each) // 2], each[-1]) for each in nodes]
    parts.extend(np.array(list(product(*some))[:_MOST_CORNERS]) for some in (ends, middles))
    return np.concatenate(parts)


def _samples(bounds: Array) -> list[Array]:
    """Return the centre of a box (2, m), its two extreme corners, and one point between."""
    low, high = bounds
    points = [low + share * (high - low) for share in (0.5, 0.0, 1.0, 0.3)]
    return points if (low < high).any() else points[:1]


def _rates(system: System, f: Any, states: Array, u: Array, d: Array) -> Array:
    """Evaluate the equations at all states at once, and return the derivatives (k, n)."""
    # Same shapes as in the solvers: states along the first axis, controls along the second.
    given = states[:, None].copy(), np.array([u, u]), np.array([d, d])
    for array in given:
        array.flags.writeable = False  # equations that change what they are given would ruin the solvers' arrays
    found = _run(system, lambda: f(*(tuple(np.moveaxis(array, -1, 0)) for array in given)), "fail")
    rates = _as_tuple(system, found)
    shape = (len(states), 2)
    columns = [_column(system, k, rate, shape) for k, rate in enumerate(rates)]
    return np.stack(columns, axis=-1)[:, 0]


def _as_tuple(system: System, found: Any) -> tuple[Any, ...]:
    names = ", ".join(system.state_names)
    try:
        rates = tuple(found)
    except TypeError:
        raise TimeToReachError(
            f"{system.name}: f(x, u, d) returns {_short(found)}: let it return a tuple with a derivative for each of "
            f"{names}"
        ) from None
    if len(rates) != len(system.states):
        raise TimeToReachError(
            f"{system.name}: f(x, u, d) returns {len(rates)} derivatives: return one for each of {names}"
        )
    return rates


def _column(system: System, k: int, rate: Any, shape: tuple[int, int]) -> Array:
    name = system.state_names[k]
    try:
        array = np.asarray(rate)
        if array.dtype.kind not in "biuf":
            raise TypeError
        return np.asarray(np.broadcast_to(array, shape), dtype=np.float64)
    except (TypeError, ValueError):
        what = "complex numbers" if np.iscomplexobj(rate) else _short(rate)
    raise TimeToReachError(f"{system.name}: the derivative of '{name}' is {what}: return a real number for each state")


def _check_finite(system: System, states: Array, rates: Array, pairs: list[tuple[Array, Array]]) -> None:
    wrong = np.argwhere(~np.isfinite(rates))
    if len(wrong):
        pair, at, k = wrong[0]
        raise TimeToReachError(
            f"{system.name}: the derivative of '{system.state_names[k]}' is {rates[pair, at, k]:g} at "
            f"{place(system, states[at])}{_given(system, pairs[pair][0])}: let the grid leave that out, or the "
            "equations be finite there"
        )


def _check_one_by_one(system: System, f: Any, states: Array, rates: Array, pairs: list[tuple[Array, Array]]) -> None:
    """Reject functions such as `max` that treat the array of states as one list of numbers."""
    some = np.linspace(0, len(states) - 1, _ONE_BY_ONE).astype(int)
    alone = np.stack([[_rates(system, f, states[i : i + 1], *pair)[0] for i in some] for pair in pairs])
    together = rates[:, some]
    differs = np.abs(alone - together) > _SAME * (1.0 + np.abs(together))
    if differs.any():
        k = int(np.argwhere(differs)[0][-1])
        raise TimeToReachError(
            f"{system.name}: the derivative of '{system.state_names[k]}' at one state depends on which others are "
            f"computed with it: use functions that work number by number ({_FUNCTIONS}), not max, min or sum"
        )


def _check_periods(
    system: System, axes: Sequence[Axis], f: Any, states: Array, rates: Array, pairs: list[tuple[Array, Array]]
) -> None:
    """Reject derivatives that differ one period on: degrees where radians are meant, or a state that counts turns."""
    for k, axis in enumerate(axes):
        if not axis.periodic:
            continue
        period = axis.upper - axis.lower
        shifted = states.copy()
        shifted[:, k] += period
        with np.errstate(all="ignore"):
            off = np.abs(np.stack([_rates(system, f, shifted, *pair) for pair in pairs]) - rates)
        wrong = np.argwhere(~(off <= _SAME_TURN * np.abs(rates).max(axis=(0, 1))))
        if len(wrong):
            pair, at, i = wrong[0]
            raise TimeToReachError(
                f"{system.name}: '{axis.name}' is periodic, but the derivative of '{system.state_names[i]}' is "
                f"{rates[pair, at, i]:.4g} at {place(system, states[at])}, and another one a period of {period:.6g} "
                f"{axis.unit} on: use sin and cos (in radians) of it, or let it be not periodic"
            )


def check_disturbances(system: System, axes: Sequence[Axis]) -> None:
    """Check that every disturbance with bounds acts on a derivative: the equations may have omitted it.

    Raises:
        TimeToReachError: A disturbance has no effect; it is named.
    """
    f, states, controls = system.equations(np, system.parameters), _grid_states(axes), _samples(system.control_bounds)
    for k, disturbance in enumerate(system.disturbances):
        sizes = [size for size in (disturbance.lower, disturbance.upper) if size != 0.0]
        if not sizes:
            continue
        still = np.zeros(len(system.states))
        acts = False
        for size, u in product(sizes, controls):
            pushed = still.copy()
            pushed[k] = size
            acts = acts or bool((_rates(system, f, states, u, pushed) != _rates(system, f, states, u, still)).any())
        if not acts:
            raise TimeToReachError(
                f"{system.name}: '{disturbance.name}' in [{disturbance.lower:g}, {disturbance.upper:g}] acts on "
                f"nothing: add d[{k}] to the derivative of '{system.state_names[k]}', or leave it in [0, 0]"
            )


def place(system: System, state: Array) -> str:
    """Format a state (n,) as text: `x 0.5 m, theta 1.57 rad`."""
    return ", ".join(f"{s.name} {number:.4g} {s.unit}" for s, number in zip(system.states, state, strict=True))


def _given(system: System, u: Array) -> str:
    if not len(u):
        return ""
    return " for " + ", ".join(f"{c.name} {number:.4g} {c.unit}" for c, number in zip(system.controls, u, strict=True))


def _run(system: System, call: Any, fails: str) -> Any:
    try:
        with np.errstate(all="ignore"):
            return call()
    except Exception as error:  # a user's function may raise anything
        reason, hint = _short(str(error) or type(error).__name__), _hint(error)
        raise TimeToReachError(f"{system.name}: the equations {fails}: {reason}{hint}") from error


def _hint(error: Exception) -> str:
    text = str(error)
    if "truth value" in text or "ambiguous" in text:
        return f"; x and u are arrays of many states: {_BRANCH}"
    if isinstance(error, AttributeError) or "scalar" in text or "only " in text or "integer" in text:
        return f"; use the functions of the `math` that is given, which all of its kinds have: {_FUNCTIONS}; {_BRANCH}"
    if "read-only" in text:
        return "; f must not change x, u or d: write y = 2 * x[0] in place of x[0] *= 2"
    if isinstance(error, KeyError):
        return " is no parameter of the system"
    if isinstance(error, IndexError):
        return "; x and d have one component for each state, u one for each control"
    return f" ({type(error).__name__})"


def _short(thing: Any) -> str:
    text = " ".join((thing if isinstance(thing, str) else repr(thing)).split())
    return text if len(text) <= 80 else f"{text[:77]}..."
