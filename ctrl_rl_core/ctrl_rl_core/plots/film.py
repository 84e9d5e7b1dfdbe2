"""Moving pictures: frames of a figure in which few artists move, as an animated GIF that holds its end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, ImageColor

from ctrl_rl_core.io.atomic_write import atomic_write
from ctrl_rl_core.plots.roles import BLACK, DANGER, FAINT, FULL, GOAL, ROBOTS, WALL
from ctrl_rl_core.plots.style import set_title, settle, style

Moment = TypeVar("Moment")
WIDTH = 960
"""Width of a moving picture [pixels]."""
HOLD = 2.0
"""How long the last frame stays, so that the end is seen [s]."""
_COLOURS = 128
_KEPT = (*ROBOTS, BLACK, DANGER, FAINT, GOAL, WALL, "#FFFFFF")
"""Colours that stay as they are, however few points have them."""


@contextmanager
def moving_picture(
    title: str, rows: int = 1, columns: int = 1, *, height: float, **layout: Any
) -> Iterator[tuple[Figure, NDArray[Any]]]:
    """Prepare a moving picture within this context, which `film` writes.

    Args:
        title: Finding in words.
        rows: Number of rows of panels.
        columns: Number of panels in a row.
        height: Height of the picture [in], of `FULL` width.
        layout: More arguments of matplotlib's `subplots`.

    Yields:
        The figure, and its axes (rows, columns).
    """
    with style():
        figure, axes = plt.subplots(
            rows, columns, figsize=(FULL, height), layout="constrained", squeeze=False, dpi=WIDTH / FULL, **layout
        )
        set_title(figure, title)
        try:
            yield figure, axes
        finally:
            plt.close(figure)


def film(
    figure: Figure,
    moving: Sequence[Artist],
    moments: Iterable[Moment],
    show: Callable[[Moment], Any],
    path: Path,
    frame_time: float = 0.1,
) -> None:
    """Write frames as an animated GIF; the file is there whole or not at all.

    Args:
        figure: Figure of `moving_picture`, with all that stays.
        moving: Artists that move.
        moments: At least one moment, a frame each.
        show: Moves the artists to a moment.
        path: File to write.
        frame_time: Duration of a frame [s].
    """
    settle(figure)
    for artist in moving:
        artist.set_animated(True)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    still = canvas.copy_from_bbox(figure.bbox)  # type: ignore[no-untyped-call]
    frames = []
    for moment in moments:
        show(moment)
        canvas.restore_region(still)  # type: ignore[no-untyped-call]
        for artist in moving:
            figure.draw_artist(artist)
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))  # type: ignore[no-untyped-call]
    palette = _palette(frames[len(frames) // 2])  # the same things move in all of them
    first, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    content = BytesIO()
    milliseconds = round(1000.0 * frame_time)
    durations = [milliseconds] * len(others) + [round(1000.0 * HOLD)]
    first.save(content, "GIF", save_all=True, append_images=others, duration=durations, loop=0, optimize=True)
    atomic_write(path, content.getvalue())


def _palette(frame: Image.Image) -> Image.Image:
    found = (frame.quantize(_COLOURS).getpalette() or [])[: 3 * _COLOURS]
    palette = Image.new("P", (1, 1))
    palette.putpalette([*found, *(value for colour in _KEPT for value in ImageColor.getrgb(colour)[:3])])
    return palette
