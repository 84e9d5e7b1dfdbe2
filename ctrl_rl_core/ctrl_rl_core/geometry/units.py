"""Quantities with units, as in task files: `0.7 m`, `60 deg`, `-0.8 .. 2.0 m/s`, `(0.0, 3.5) m`.

Parsed values are in SI units: metres, seconds, radians, kilograms, newtons.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

from pydantic import AfterValidator, BeforeValidator

from ctrl_rl_core.io.file_checks import short_repr

_FACTORS: dict[str, dict[str, float]] = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180.0},
    "m/s^2": {"m/s^2": 1.0},
    "rad/s^2": {"rad/s^2": 1.0},
    "Hz": {"Hz": 1.0},
    "kg": {"kg": 1.0, "g": 1e-3},
    "kg m^2": {"kg m^2": 1.0},
    "N": {"N": 1.0},
    "N m": {"N m": 1.0},
    "N s/m": {"N s/m": 1.0},
    "N m s/rad": {"N m s/rad": 1.0},
    "1": {"": 1.0, "1": 1.0},
}


_LARGEST: dict[str, float] = {"m": 1e5, "s": 1e6, "rad": 1e3, "m/s": 1e3, "rad/s": 1e4, "Hz": 1e5}
"""Largest magnitude accepted for physical quantities, in SI units; 1e9 for others."""
_LEAST = 1e-6
"""Smallest accepted value of a positive quantity, in SI units."""
_LONGEST = 200
_NUMBER = r"[-+]?(?:\d+(?:\.\d+)?|\.\d+)(?:[eE][-+]?\d+)?"
_QUANTITY = re.compile(rf"(\(.*\)|{_NUMBER}(?:\s*\.\.\s*{_NUMBER})?)\s*(.*)")


class Interval(NamedTuple):
    """A closed interval, low <= high, in SI units."""

    low: float
    high: float

    @property
    def centre(self) -> float:
        """Midpoint."""
        return 0.5 * (self.low + self.high)

    @property
    def length(self) -> float:
        """Difference between the bounds."""
        return self.high - self.low

    def __contains__(self, value: object) -> bool:
        return isinstance(value, int | float) and self.low <= value <= self.high


def parse_scalar(text: object, unit: str) -> float:
    """Parse `0.7 m` to SI units.

    Args:
        text: A number and a unit of the same dimension as `unit`; for the unit "1", just the number.
        unit: Expected SI unit, a key of the table above.

    Raises:
        ValueError: The number or unit is missing, or the unit has another dimension.
    """
    number, factor = _split(text, unit)
    return _number(number, text, factor, unit)


def parse_interval(text: object, unit: str) -> Interval:
    """Parse `low .. high unit` to SI units; a single quantity gives an interval of length zero.

    Raises:
        ValueError: As for `parse_scalar`, or low > high.
    """
    body, factor = _split(text, unit)
    low, dots, high = body.partition("..")
    if not dots:
        value = _number(body, text, factor, unit)
        return Interval(value, value)
    out = Interval(_number(low, text, factor, unit), _number(high, text, factor, unit))
    if out.low > out.high:
        raise ValueError(f"{short_repr(text)} runs backwards: write the lower bound first")
    return out


def parse_vector(text: object, unit: str, size: int) -> tuple[float, ...]:
    """Parse `(a, b) unit` to SI units.

    Raises:
        ValueError: As for `parse_scalar`, or there are not `size` numbers in parentheses.
    """
    body, factor = _split(text, unit)
    if not (body.startswith("(") and body.endswith(")")):
        raise ValueError(
            f"{short_repr(text)} must be {size} numbers in parentheses and a unit, "
            f"e.g. ({', '.join(['1.0'] * size)}) {unit}"
        )
    parts = body[1:-1].split(",")
    if len(parts) != size:
        raise ValueError(f"{short_repr(text)} has {len(parts)} numbers, must have {size}")
    return tuple(_number(part, text, factor, unit) for part in parts)


def _split(text: object, unit: str) -> tuple[str, float]:
    """Split off the unit; return the rest and the unit's factor to SI."""
    plain = isinstance(text, str | int | float) and not isinstance(text, bool)
    said = str(text).strip() if plain and not (isinstance(text, int) and abs(text) > 1e30) else ""
    match = _QUANTITY.fullmatch(said) if len(said) <= _LONGEST else None
    if match is None:
        raise ValueError(
            f"{short_repr(text)} is not a quantity: write e.g. '{f'1.0 {unit}' if unit != '1' else '1.0'}'"
        )
    body, given = match.groups()
    if given not in _FACTORS[unit]:
        known = ", ".join(name for name in _FACTORS[unit] if name) or "no unit"
        has = f"unit {short_repr(given)}" if given else "no unit"
        raise ValueError(f"{short_repr(text)} has {has}: must be in {known}")
    return body, _FACTORS[unit][given]


def _number(part: str, whole: object, factor: float, unit: str) -> float:
    try:
        value = float(part)
    except ValueError:
        raise ValueError(f"{short_repr(whole)}: {short_repr(part.strip())} is not a number") from None
    largest = _LARGEST.get(unit, 1e9)
    if not abs(value * factor) <= largest:
        raise ValueError(f"{short_repr(whole)} is too large: at most {largest:g} {unit} makes sense")
    # 70 cm must parse to 0.7 m, not 0.7000000000000001 m, so that equal quantities give equal digests.
    return value if factor == 1.0 else float(f"{value * factor:.15g}")


def _scalar(unit: str, positive: bool = False, largest: float = math.inf) -> Callable[[Any], float]:
    def parse(value: Any) -> float:
        out = parse_scalar(value, unit)
        if out > largest:
            raise ValueError(f"{short_repr(value)} is too large: at most {largest:g} {unit} makes sense")
        if positive and out < _LEAST:
            raise ValueError(f"{short_repr(value)} must be at least {_LEAST:g} {unit}")
        return out

    return parse


def _interval(unit: str) -> Callable[[Any], Interval]:
    return lambda value: parse_interval(value, unit)


def _vector(unit: str) -> Callable[[Any], tuple[float, ...]]:
    return lambda value: parse_vector(value, unit, 2)


def _not_negative(interval: Interval) -> Interval:
    if interval.low < 0.0:
        raise ValueError(f"{interval.low:g}: must be at least 0")
    return interval


def _positive(interval: Interval) -> Interval:
    if interval.low < _LEAST:
        raise ValueError(f"{interval.low:g}: must be at least {_LEAST:g}")
    return interval


Length = Annotated[float, BeforeValidator(_scalar("m"))]
PositiveLength = Annotated[float, BeforeValidator(_scalar("m", positive=True))]
Time = Annotated[float, BeforeValidator(_scalar("s"))]
PositiveTime = Annotated[float, BeforeValidator(_scalar("s", positive=True))]
TimeStep = Annotated[float, BeforeValidator(_scalar("s", positive=True, largest=60.0))]
"""Duration of a policy step [s]."""
Angle = Annotated[float, BeforeValidator(_scalar("rad"))]
PositiveSpeed = Annotated[float, BeforeValidator(_scalar("m/s", positive=True))]
PositiveRate = Annotated[float, BeforeValidator(_scalar("Hz", positive=True))]
LengthInterval = Annotated[Interval, BeforeValidator(_interval("m"))]
AngleInterval = Annotated[Interval, BeforeValidator(_interval("rad"))]
TimeInterval = Annotated[Interval, BeforeValidator(_interval("s")), AfterValidator(_not_negative)]
PositiveSpeedInterval = Annotated[Interval, BeforeValidator(_interval("m/s")), AfterValidator(_positive)]
Point = Annotated[tuple[float, float], BeforeValidator(_vector("m"))]
