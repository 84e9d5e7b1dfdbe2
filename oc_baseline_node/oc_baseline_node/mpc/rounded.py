"""Smooths model equations at the points where sqrt, fractional powers, asin etc. are not differentiable.

For example, |v| v written with a square root gives 0/0 at rest. Each such operation is replaced by one that is finite
everywhere and differs by 1e-4 at the corner and far less elsewhere. Trajectories are checked with the original
equations, so the replacement changes none by more than the tolerance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi

_ROUND = 1e-8
"""Term added under a root; its square root is the error at the corner."""
_APART = 1e-8
"""Divisor below which a quotient returns smoothly to zero."""
_LARGEST_EXPONENT = 300.0
"""Exponent beyond which exp stays constant, because its square would be infinite."""


def rounded(function: casadi.Function) -> tuple[casadi.Function, tuple[str, ...]]:
    """Return an SX function without corners, and the names of the smoothed operations.

    Quotients and exp are kept finite too, but not listed, since they are differentiable wherever defined. A function
    without corners is returned unchanged.
    """
    found = _corners(function)
    if not found:
        return function, ()
    names = tuple(name for name in found if name not in _SMOOTH)
    inputs = [casadi.SX.sym(f"i{k}", function.size1_in(k), function.size2_in(k)) for k in range(function.n_in())]
    outputs = [casadi.SX(function.sparsity_out(k)) for k in range(function.n_out())]
    work: list[Any] = [casadi.SX(0)] * function.sz_w()
    for k in range(function.n_instructions()):
        operation, into, out = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if operation == casadi.OP_CONST:
            work[out[0]] = casadi.SX(function.instruction_constant(k))
        elif operation == casadi.OP_INPUT:
            work[out[0]] = inputs[into[0]].nonzeros()[into[1]]
        elif operation == casadi.OP_OUTPUT:
            outputs[out[0]].nz[out[1]] = work[into[0]]
        else:
            work[out[0]] = _replaced(operation, [work[i] for i in into])
    return casadi.Function(function.name(), inputs, outputs), names


def _corners(function: casadi.Function) -> tuple[str, ...]:
    """Return the names of the operations that are not differentiable everywhere, in order of appearance."""
    constant: dict[int, bool] = {}
    found: dict[str, None] = {}
    for k in range(function.n_instructions()):
        operation, into, out = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if operation in (casadi.OP_INPUT, casadi.OP_OUTPUT):
            if operation == casadi.OP_INPUT:
                constant[out[0]] = False
            continue
        known = [constant[i] for i in into]
        divided_by_number = operation == casadi.OP_DIV and known[1]
        if operation in _NAMES and not divided_by_number and not all(known):
            found[_NAMES[operation]] = None
        constant[out[0]] = all(known)
    return tuple(found)


def _replaced(operation: int, terms: list[Any]) -> Any:
    terms = [casadi.SX(term) for term in terms]
    if operation in _REPLACEMENTS and not all(term.is_constant() for term in terms):
        return _REPLACEMENTS[operation](*terms)
    if len(terms) == 2:
        return casadi.SX.binary(operation, *terms)
    return casadi.SX.unary(operation, terms[0])


def _positive(z: Any) -> Any:
    """Return z if positive; otherwise a value slightly above zero."""
    return 0.5 * (z + casadi.sqrt(z * z + _ROUND**2)) + _ROUND


def _quotient(a: Any, b: Any) -> Any:
    return a / b if b.is_constant() else a * b / (b * b + _APART**2)


def _inside(z: Any) -> Any:
    """Return z clipped smoothly to (-1, 1)."""
    return casadi.fmin(casadi.fmax(z, -1.0), 1.0) * (1.0 - _ROUND)


def _exponential(z: Any) -> Any:
    return casadi.exp(casadi.fmin(z, _LARGEST_EXPONENT))


def _power(base: Any, exponent: Any) -> Any:
    if exponent.is_constant():
        number = float(exponent)
        if number == int(number):
            return base ** int(number) if number >= 0.0 else _quotient(casadi.SX(1.0), base ** int(-number))
        return casadi.constpow(_positive(base), exponent)
    return _exponential(exponent * casadi.log(_positive(base)))


_REPLACEMENTS: dict[int, Callable[..., Any]] = {
    casadi.OP_SQRT: lambda z: casadi.sqrt(_positive(z)),
    casadi.OP_HYPOT: lambda a, b: casadi.sqrt(a * a + b * b + _ROUND),
    casadi.OP_POW: _power,
    casadi.OP_CONSTPOW: _power,
    casadi.OP_DIV: _quotient,
    casadi.OP_INV: lambda b: _quotient(casadi.SX(1.0), b),
    casadi.OP_LOG: lambda z: casadi.log(_positive(z)),
    casadi.OP_LOG1P: lambda z: casadi.log(_positive(1.0 + z)),
    casadi.OP_ASIN: lambda z: casadi.asin(_inside(z)),
    casadi.OP_ACOS: lambda z: casadi.acos(_inside(z)),
    casadi.OP_ATANH: lambda z: casadi.atanh(_inside(z)),
    casadi.OP_ACOSH: lambda z: casadi.acosh(casadi.fmax(z, 1.0) + _ROUND),
    casadi.OP_ATAN2: lambda y, x: casadi.atan2(y, x + _APART),
    casadi.OP_EXP: _exponential,
}
_SMOOTH = ("a quotient", "exp")
_NAMES = {
    casadi.OP_SQRT: "sqrt",
    casadi.OP_HYPOT: "hypot",
    casadi.OP_POW: "pow",
    casadi.OP_CONSTPOW: "pow",
    casadi.OP_DIV: "a quotient",
    casadi.OP_INV: "a quotient",
    casadi.OP_LOG: "log",
    casadi.OP_LOG1P: "log1p",
    casadi.OP_ASIN: "asin",
    casadi.OP_ACOS: "acos",
    casadi.OP_ATANH: "atanh",
    casadi.OP_ACOSH: "acosh",
    casadi.OP_ATAN2: "atan2",
    casadi.OP_EXP: "exp",
}
