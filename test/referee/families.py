"""The families of systems, and what a seed draws from them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from referee.boats import draw_boat, draw_zermelo
from referee.carts import draw_cart
from referee.case import Case
from referee.drift import draw_stream, draw_turning
from referee.dubins import draw_dubins
from referee.products import draw_product
from referee.scalar import draw_lag, draw_line, draw_nonlinear
from referee.springs import draw_motor, draw_spring
from referee.swings import draw_bent, draw_pendulum

FAMILIES: dict[str, Callable[[np.random.Generator], Case]] = {
    "line": draw_line,
    "lag": draw_lag,
    "nonlinear": draw_nonlinear,
    "turning": draw_turning,
    "stream": draw_stream,
    "boat": draw_boat,
    "zermelo": draw_zermelo,
    "cart": draw_cart,
    "spring": draw_spring,
    "motor": draw_motor,
    "bent": draw_bent,
    "pendulum": draw_pendulum,
    "product": draw_product,
    "dubins": draw_dubins,
}


def family_of(seed: int) -> str:
    """Return the family that a seed draws from: all in turn."""
    return list(FAMILIES)[seed % len(FAMILIES)]


def draw(seed: int) -> Case:
    """Return the system of a seed."""
    return FAMILIES[family_of(seed)](np.random.default_rng(seed))
