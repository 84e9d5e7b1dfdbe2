"""Quantities with units."""

import math

import pytest
from ctrl_rl_core.geometry.units import parse_interval, parse_scalar, parse_vector
from hypothesis import given
from hypothesis import strategies as st

from ctrl_rl_core import Interval

NUMBERS = st.floats(-1e5, 1e5, allow_nan=False)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("0.7 m", "m", 0.7),
        ("70 cm", "m", 0.7),
        ("90 deg", "rad", math.pi / 2),
        ("200ms", "s", 0.2),
        ("9.81 m/s^2", "m/s^2", 9.81),
        ("-2 m/s", "m/s", -2.0),
        ("1e-3 kg m^2", "kg m^2", 1e-3),
        (5, "1", 5.0),
    ],
)
def test_a_quantity_is_read_in_si_units(text: object, unit: str, value: float) -> None:
    assert parse_scalar(text, unit) == pytest.approx(value)


@given(NUMBERS, NUMBERS)
def test_intervals_and_vectors_keep_their_numbers(a: float, b: float) -> None:
    low, high = sorted((a, b))
    assert parse_interval(f"{low!r} .. {high!r} m", "m") == Interval(low, high)
    assert parse_vector(f"({a!r}, {b!r}) m", "m", 2) == (a, b)


@pytest.mark.parametrize(
    ("text", "unit", "words"),
    [
        ("0.7", "m", "no unit"),
        (0.7, "m", "no unit"),
        ("0.7 s", "m", "unit 's'"),
        ("0.7 parsec", "m", "unit 'parsec'"),
        ("wide", "m", "not a quantity"),
        ("nan m", "m", "not a quantity"),
        ("1e999 m", "m", "too large"),
        (True, "m", "not a quantity"),
        (None, "m", "not a quantity"),
    ],
)
def test_a_wrong_quantity_says_what_is_wrong(text: object, unit: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parse_scalar(text, unit)


def test_shapes_are_checked() -> None:
    with pytest.raises(ValueError, match="has 3 numbers, must have 2"):
        parse_vector("(1, 2, 3) m", "m", 2)
    with pytest.raises(ValueError, match="in parentheses"):
        parse_vector("1 m", "m", 2)
    with pytest.raises(ValueError, match="runs backwards"):
        parse_interval("2 .. 1 m", "m")
    with pytest.raises(ValueError, match="is not a number"):
        parse_scalar("1 .. 2 m", "m")
