"""Colours of the page: those of the figures by role, as numbers, since `ctrl_rl_core.plots` needs matplotlib."""

from __future__ import annotations

Colour = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""

BODY, EDGE = (245, 245, 245), (20, 20, 20)
SENT, RAW, SCAN = (0, 114, 178), (140, 140, 140), (86, 180, 233)
GOAL, WARNING, DANGER = (0, 158, 115), (230, 159, 0), (213, 94, 0)
WALL, UNKNOWN = (77, 77, 77), (224, 224, 224)
_WORSE = (0, 34, 78), (18, 53, 112), (59, 73, 108), (87, 93, 109), (112, 113, 115)
_BETTER = (138, 134, 120), (165, 156, 116), (195, 179, 105), (225, 204, 85), (254, 232, 56)
VALUES = (*_WORSE, *_BETTER)
"""Colours of values, evenly spaced, the worst first."""
