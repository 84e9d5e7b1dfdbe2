"""Places text in a figure so that it covers no data: labels at the right end of lines, words beside positions."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from ctrl_rl_core.plots.roles import SMALL

_NAME, _WORD, SOLID = "name of a line", "word beside a place", "wall or obstacle"
_GAP = 2.0
_ON_WALL, _FAR = 0.2, 0.01
"""Cost of text on a wall, and of each point of distance from its position, in covered line points."""
_CLOSE = 4.0
"""Spacing of the points that represent a line [pixels]."""
_REACH = (7.0, 12.0, 18.0, 28.0, 42.0, 60.0)
_DIRECTIONS = ((1, 1), (1, -1), (-1, 1), (-1, -1), (0, 1), (0, -1), (1, 0), (-1, 0))
_ASIDE = (0.0, 0.25, -0.25)
"""Shifts of a word above or below its position, in word widths: a narrow passage has room for one of them."""
_SIDES: dict[int, Literal["left", "right", "center"]] = {1: "left", -1: "right", 0: "center"}
_HEIGHTS: dict[int, Literal["bottom", "top", "center"]] = {1: "bottom", -1: "top", 0: "center"}


def name_at_end(axes: Axes, name: str, height: float, colour: str) -> None:
    """Write a line's label at the right edge of its panel.

    Args:
        axes: Panel of the line.
        name: Name of the line.
        height: End of the line [unit of the y axis].
        colour: Colour of the line.
    """
    axes.annotate(
        name,
        (1.0, height),
        (6.0, 0.0),
        xycoords=axes.get_yaxis_transform(),
        textcoords="offset points",
        verticalalignment="center",
        color=colour,
        annotation_clip=False,
        gid=_NAME,
    )


def word_at(axes: Axes, word: str, place: tuple[float, float], colour: str = "black") -> None:
    """Write a word beside a position, on the side where it covers no line and no other word.

    Args:
        axes: Panel of the position.
        word: Word to write.
        place: Position [units of the axes].
        colour: Colour of the word.
    """
    axes.annotate(
        word,
        place,
        (_REACH[0], _REACH[0]),
        textcoords="offset points",
        color=colour,
        bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "alpha": 0.8, "linewidth": 0},
        gid=_WORD,
        zorder=9,
    )


def write_small(axes: Axes, word: str, place: tuple[float, float], rotation: float = 0.0) -> None:
    """Write a word centred at a position, in the smallest type."""
    axes.text(*place, word, horizontalalignment="center", verticalalignment="center", size=SMALL, rotation=rotation)


def place_names(axes: Axes) -> None:
    """Separate the labels at the right edge of a panel, in the order of their lines."""
    names = [text for text in axes.texts if isinstance(text, Annotation) and text.get_gid() == _NAME]
    if not names:
        return
    points = axes.get_figure(root=True).dpi / 72.0  # type: ignore[union-attr]
    ends = [axes.transData.transform((0.0, float(text.xy[1])))[1] for text in names]
    heights = [text.get_window_extent().height + _GAP * points for text in names]
    order = np.argsort(ends)
    centres = np.array([ends[index] for index in order])
    sizes = np.array([heights[index] for index in order])
    low, high = axes.bbox.y0 + 0.5 * sizes, axes.bbox.y1 - 0.5 * sizes
    for _ in range(500):
        for below, above in pairwise(range(len(order))):
            lack = 0.5 * (sizes[below] + sizes[above]) - (centres[above] - centres[below])
            if lack > 0.0:
                centres[below] -= 0.5 * lack
                centres[above] += 0.5 * lack
        if sizes.sum() < axes.bbox.height:  # otherwise not all of them fit beside the panel
            centres = np.clip(centres, low, high)
    for centre, index in zip(centres, order, strict=True):
        names[index].xyann = (6.0, (centre - ends[index]) / points)


def place_words(axes: Axes) -> None:
    """Move each word near its position, to where it covers no line or other word and little wall."""
    words = [text for text in axes.texts if isinstance(text, Annotation) and text.get_gid() == _WORD]
    points = line_points(axes)
    walls = [patch.get_window_extent() for patch in axes.patches if patch.get_gid() == SOLID]
    there: list[Bbox] = [text.get_window_extent() for text in axes.texts if text not in words]
    for word in words:
        wide = word.get_window_extent().width * 72.0 / axes.get_figure(root=True).dpi  # type: ignore[union-attr]
        best, least = _Spot(0.0, 0, 1), np.inf
        for spot in _spots(wide):
            spot.put(word)
            box = word.get_window_extent().padded(2.0)
            covered = covers(box, points) + 50.0 * sum(box.overlaps(other) for other in there)
            covered += _ON_WALL * any(box.overlaps(wall) for wall in walls) + _FAR * spot.reach
            covered += 0.0 if _within(box, axes.bbox) else 1000.0
            if covered < least:
                best, least = spot, covered
        best.put(word)
        there.append(word.get_window_extent())


class _Spot(NamedTuple):
    """Where a word may stand: a distance [points] in a direction, and a shift aside [points]."""

    reach: float
    across: int
    up: int
    aside: float = 0.0

    def put(self, word: Annotation) -> None:
        """Move a word there."""
        word.xyann = (self.across * self.reach + self.aside, self.up * self.reach)
        word.set_horizontalalignment(_SIDES[self.across])
        word.set_verticalalignment(_HEIGHTS[self.up])


def _spots(wide: float) -> Iterator[_Spot]:
    """Yield the places to try for a word of some width [points]."""
    for reach in _REACH:
        for across, up in _DIRECTIONS:
            for aside in _ASIDE if across == 0 else (0.0,):
                yield _Spot(reach, across, up, aside * wide)


def covers(box: Bbox, points: NDArray[np.float64]) -> int:
    """Return the number of points (n, 2) that lie in a box."""
    inside = (points[:, 0] > box.x0) & (points[:, 0] < box.x1) & (points[:, 1] > box.y0) & (points[:, 1] < box.y1)
    return int(inside.sum())


def line_points(axes: Axes) -> NDArray[np.float64]:
    """Return points (n, 2) along a panel's lines in pixels, spaced closely enough that no word fits between them."""
    found = [np.empty((0, 2))]
    for line in axes.lines:
        if line.get_transform() != axes.transData or not line.get_visible():
            continue  # a thin line across the panel marks a limit
        at = axes.transData.transform(np.column_stack(line.get_data()).astype(float))
        at = at[np.isfinite(at).all(axis=1)]
        found.append(at)
        if len(at) > 1 and line.get_linestyle() not in ("None", "", " "):
            way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(at, axis=0).T))))
            steps = np.arange(0.0, way[-1], _CLOSE)
            found.append(np.column_stack([np.interp(steps, way, column) for column in at.T]))
    every = np.vstack(found)
    low, high = np.asarray(axes.bbox.min) - 1.0, np.asarray(axes.bbox.max) + 1.0  # points beyond are clipped
    return every[((every >= low) & (every <= high)).all(axis=1)]


def _within(box: Bbox, outer: Bbox) -> bool:
    return bool(box.x0 >= outer.x0 and box.x1 <= outer.x1 and box.y0 >= outer.y0 and box.y1 <= outer.y1)
