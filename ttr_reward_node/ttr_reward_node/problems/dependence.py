"""Dependence of each derivative of a system on states, controls and disturbances.

The equations of a system consist of arithmetic and functions such as sin and cos, so they are run once on numbers that
record their dependences. This is exact, whereas varying the states one at a time finds only the dependences visible at
the sampled states, controls and disturbances.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from ctrl_rl_core import Quantity, System
from ttr_reward_node.errors import TimeToReachError

AFFINE = 1
"""Largest degree of a derivative that is affine in the controls or disturbances."""
_NONLINEAR = 2


@dataclass(frozen=True)
class Dependence:
    """Dependence of one derivative.

    Attributes:
        states, controls, disturbances: Indices of the components that it depends on.
        control_degree, disturbance_degree: 0 if it depends on none of them, 1 if it is affine in them, else 2.
        coupled: Whether a control and a disturbance are multiplied or are arguments of the same function.
    """

    states: frozenset[int] = frozenset()
    controls: frozenset[int] = frozenset()
    disturbances: frozenset[int] = frozenset()
    control_degree: int = 0
    disturbance_degree: int = 0
    coupled: bool = False


def dependences(system: System, *, hold: bool = True) -> tuple[Dependence, ...]:
    """Return the dependence of each derivative of a system; an overestimate if terms cancel.

    Equations that branch on a value (`if x[0] > 1`) cannot be traced: all derivatives then depend on everything.

    Args:
        system: System with its bounds and parameters.
        hold: Whether controls and disturbances with equal bounds are constants. If false, all controls are free and
            disturbances are absent.
    """
    n = len(system.states)
    x = [_TracedNumber(Dependence(states=frozenset({i}))) for i in range(n)]
    free_u = [not hold or control.lower < control.upper for control in system.controls]
    free_d = [hold and disturbance.lower < disturbance.upper for disturbance in system.disturbances]
    u = [
        _TracedNumber(Dependence(controls=frozenset({i}), control_degree=1)) if free else _fixed_value(control)
        for i, (control, free) in enumerate(zip(system.controls, free_u, strict=True))
    ]
    d = [
        _TracedNumber(Dependence(disturbances=frozenset({i}), disturbance_degree=1))
        if free
        else _fixed_value(disturbance)
        for i, (disturbance, free) in enumerate(zip(system.disturbances, free_d, strict=True))
    ]
    try:
        rates = system.equations(_TracedMath(), system.parameters)(x, u, d)
        found = [rate.dependence if isinstance(rate, _TracedNumber) else Dependence() for rate in rates]
    except Exception:  # any function may fail on a number without a value
        controls, disturbances = _true_indices(free_u), _true_indices(free_d)
        found = [_bent(Dependence(frozenset(range(n)), controls, disturbances))] * n
    return tuple(found)


def check_game(system: System) -> None:
    """Check that the worst disturbance lies at the bounds.

    The solvers try only the corners of the disturbance's box. The worst disturbance is a corner if each derivative is
    affine in the disturbance and the effect of the disturbance does not depend on the control.

    Raises:
        TimeToReachError: Some derivative depends on the disturbance in another way; names the state.
    """
    for state, rate in zip(system.states, dependences(system), strict=True):
        wrong = "control and disturbance together" if rate.coupled else "more than linearly"
        if rate.coupled or rate.disturbance_degree > AFFINE:
            raise TimeToReachError(
                f"{system.name}: the disturbance acts on the derivative of '{state.name}' {wrong}; its worst value may "
                "lie between its bounds, which alone are tried: make it linear, with an effect that no control changes"
            )


def is_affine(system: System) -> bool:
    """Whether every derivative is affine in the controls, so that the best control lies at the bounds."""
    return all(rate.control_degree <= AFFINE for rate in dependences(system))


def check_affine_controls(system: System) -> None:
    """Check that the best control lies at the bounds.

    Raises:
        TimeToReachError: A derivative is not affine in the controls; names the state.
    """
    for state, rate in zip(system.states, dependences(system), strict=True):
        if rate.control_degree > AFFINE:
            raise TimeToReachError(
                f"{system.name}: the derivative of '{state.name}' is not affine in the controls, of which "
                "Lax-Friedrichs tries the bounds alone: use semi_lagrangian, with more samples (control_counts)"
            )


def _fixed_value(quantity: Quantity) -> float:
    return quantity.lower if quantity.lower == quantity.upper else 0.0


def _true_indices(flags: list[bool]) -> frozenset[int]:
    return frozenset(i for i, flag in enumerate(flags) if flag)


class _TracedNumber:
    """Number without a value that records its dependences."""

    __array_ufunc__ = None  # arithmetic with NumPy scalars is delegated to this class
    __slots__ = ("dependence",)

    def __init__(self, dependence: Dependence) -> None:
        self.dependence = dependence

    def __add__(self, other: Any) -> _TracedNumber:
        return _join(self, other, max)

    def __mul__(self, other: Any) -> _TracedNumber | float:
        if not isinstance(other, _TracedNumber) and other == 0:
            return 0.0
        return _join(self, other, lambda one, two: min(one + two, _NONLINEAR), multiply=True)

    def __truediv__(self, other: Any) -> _TracedNumber:
        return self * (_apply(other) if isinstance(other, _TracedNumber) else 1.0)  # type: ignore[return-value]

    def __rtruediv__(self, other: Any) -> _TracedNumber | float:
        return 0.0 if other == 0 else _apply(self)

    def __pow__(self, other: Any) -> _TracedNumber:
        return _apply(self, other)

    def __neg__(self) -> _TracedNumber:
        return self

    def __abs__(self) -> _TracedNumber:
        return _apply(self)

    def __bool__(self) -> bool:
        raise TypeError("a traced number has no value")

    def __eq__(self, other: object) -> Any:
        return _apply(self, other)

    __hash__ = None  # type: ignore[assignment]
    __ne__ = __eq__
    __radd__ = __sub__ = __rsub__ = __add__
    __rmul__ = __mul__
    __rpow__ = __mod__ = __rmod__ = __floordiv__ = __rfloordiv__ = __pow__
    __lt__ = __le__ = __gt__ = __ge__ = __pow__
    __pos__ = __neg__


class _TracedMath:
    """Namespace like `math`: its constants, and functions that count as nonlinear in their arguments."""

    def __getattr__(self, name: str) -> Any:
        constant = getattr(math, name, None)
        return constant if isinstance(constant, float) else _function(getattr(math, name, None))


def _function(real: Callable[..., Any] | None) -> Callable[..., Any]:
    def apply(*arguments: Any) -> Any:
        if real is not None and not any(isinstance(argument, _TracedNumber) for argument in arguments):
            return real(*arguments)
        return _apply(*arguments)

    return apply


def _apply(*arguments: Any) -> _TracedNumber:
    """Return the traced result of a possibly nonlinear function of numbers, some of which are traced."""
    known = _TracedNumber(Dependence())
    for argument in arguments:
        known = _join(known, argument, max)
    return _TracedNumber(_bent(known.dependence))


def _bent(given: Dependence) -> Dependence:
    """Return the dependence of a possibly nonlinear function."""
    return replace(
        given,
        control_degree=_NONLINEAR if given.controls else 0,
        disturbance_degree=_NONLINEAR if given.disturbances else 0,
        coupled=bool(given.controls and given.disturbances),
    )


def _join(
    one: _TracedNumber, other: Any, degree: Callable[[int, int], int], *, multiply: bool = False
) -> _TracedNumber:
    a, b = one.dependence, other.dependence if isinstance(other, _TracedNumber) else Dependence()
    if not isinstance(other, _TracedNumber):
        float(other)  # raises TypeError for non-numbers
    meet = bool((a.controls and b.disturbances) or (a.disturbances and b.controls))
    return _TracedNumber(
        Dependence(
            a.states | b.states,
            a.controls | b.controls,
            a.disturbances | b.disturbances,
            degree(a.control_degree, b.control_degree),
            degree(a.disturbance_degree, b.disturbance_degree),
            a.coupled or b.coupled or (multiply and meet),
        )
    )
