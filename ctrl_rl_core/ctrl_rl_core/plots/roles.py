"""Colour roles, type and figure sizes, and the line style of each method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ctrl_rl_core.tasks.regions import ANGLES

FULL, HALF = 7.0, 3.4
"""Figure widths: the 688 px column of the page, and half of it [in]."""
SMALL, TEXT, TITLE = 8.0, 9.0, 10.0
"""Type sizes [pt]; nothing is smaller than `SMALL`."""
OURS_COLOUR, SKY, ORANGE, BLACK, FAINT = "#0072B2", "#56B4E9", "#E69F00", "#000000", "#8C8C8C"
DANGER, GOAL, WALL, UNKNOWN = "#D55E00", "#009E73", "#4D4D4D", "#E0E0E0"
ROBOTS = (OURS_COLOUR, SKY, ORANGE)
"""Colours of several robots in one figure."""
GRID = "#CCCCCC"
VALUES, SIGNED, COUNTS = "cividis_r", "PuOr", "Greys"
"""Colour maps: times, short ones bright; signed values; counts, logarithmic."""
RETURNS = VALUE_MAP = "cividis"
"""Colour map of returns, high ones bright, and of weights."""
GREY_MAP = "gray"
"""Colour map of camera images."""


@dataclass(frozen=True)
class Style:
    """Line style.

    Attributes:
        colour: Colour of the line, its points and its band.
        line: matplotlib's line style.
        width: Width of the line [pt].
        marker: Marker used when the line is drawn as points.
    """

    colour: str
    line: str = "-"
    width: float = 1.4
    marker: str = "o"


OURS = Style(OURS_COLOUR, width=2.2)
VARIANT, SECOND_VARIANT = Style(SKY, marker="s"), Style(ORANGE, marker="D")
OTHER, SECOND_OTHER = Style(BLACK, "--", marker="^"), Style(BLACK, "-.", marker="v")
NO_HELP = Style(FAINT, ":", marker="x")

METHODS: Mapping[str, Style] = {
    # rewards and baselines based on the time to reach
    **dict.fromkeys(("best_progress", "ttr_progress"), OURS),
    **dict.fromkeys(("progress", "ttr"), VARIANT),
    **dict.fromkeys(("best_progress_distance", "v_corrected"), SECOND_VARIANT),
    **dict.fromkeys(("distance", "distance_10"), OTHER),
    **dict.fromkeys(("progress_distance", "distance_0"), SECOND_OTHER),
    "sparse": NO_HELP,
    # baselines of the policy gradient
    "oc_ppo": OURS,
    **dict.fromkeys(("oc_corrected", "noise_0.05"), VARIANT),
    **dict.fromkeys(("oc_trpo", "oc_lambda_0.7", "noise_0.1"), SECOND_VARIANT),
    "noise_0.2": NO_HELP,
    **dict.fromkeys(("ppo", "entropy_0.01"), OTHER),
    **dict.fromkeys(("trpo", "lambda_0.7", "stein", "entropy_0.05"), SECOND_OTHER),
    **dict.fromkeys(("q_prop", "entropy_0.1"), NO_HELP),
    # Koopman control
    **dict.fromkeys(("koopman", "averaged", "cheetah_run_fine", "model"), OURS),
    **dict.fromkeys(("reconstruction", "actor", "latent_30"), VARIANT),
    **dict.fromkeys(("reconstruction_prediction", "latent_100"), SECOND_VARIANT),
    **dict.fromkeys(("network", "two_stage"), OTHER),
    **dict.fromkeys(("sac", "edmd"), SECOND_OTHER),
    # joint options
    "async": OURS,
    "async_autoregressive": VARIANT,
    "async_mixture": SECOND_VARIANT,
    "sync_wait": OTHER,
    "mac_dqn": SECOND_OTHER,
    "end2end": NO_HELP,
    # the safety filter around a learner
    "shield, sent": OURS,
    "no shield": NO_HELP,
}
"""Line style by method name. Unlisted names are custom variants, see `style_of`."""
_SPARE = (SECOND_VARIANT, VARIANT, SECOND_OTHER, NO_HELP, OTHER)


def style_of(name: str, taken: Mapping[str, Style]) -> Style:
    """Return a method's style: its own, or the first one that no other line of the figure uses.

    Args:
        name: Name of the method.
        taken: Styles of the other lines in the figure.
    """
    if name in METHODS and METHODS[name] not in taken.values():
        return METHODS[name]
    free = [style for style in _SPARE if style not in taken.values()]
    return free[0] if free else replace(OTHER, line=(0, (1.0, 1.0 + len(taken))))  # type: ignore[arg-type]


def greys(count: int) -> list[str]:
    """Return this many greys, lightest first, on which black text is legible."""
    return [f"{level:.2f}" for level in np.linspace(0.93, 0.6, count)]


def named_value(name: str, value: float) -> str:
    """Format a state's name and value; an angle [rad] in degrees, with an arrow in its direction."""
    if name not in ANGLES:
        return f"{name} = {value:.3g}"
    return f"{name} = {np.rad2deg(value):.0f}° {'→↗↑↖←↙↓↘'[round(value / (0.25 * np.pi)) % 8]}"
