"""Animated GIFs: frames of a figure in which a few artists move; the last frame is held."""

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
"""Width of an animation [pixels]."""
HOLD = 2.0
"""Duration of the last frame, which shows the result [s]."""
_COLOURS = 128
_KEPT = (*ROBOTS, BLACK, DANGER, FAINT, GOAL, WALL, "#FFFFFF")
"""Colours kept exactly in the palette, however few pixels use them."""


@contextmanager
def moving_picture(
    title: str, rows: int = 1, columns: int = 1, *, height: float, **layout: Any
) -> Iterator[tuple[Figure, NDArray[Any]]]:
    """Prepare a figure for an animation within this context; `film` writes it.

    Args:
        title: Title; a sentence that states the finding.
        rows: Number of rows of panels.
        columns: Number of panels in a row.
        height: Height of the figure [in]; its width is `FULL`.
        layout: Further arguments for matplotlib's `subplots`.

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
    """Write frames as an animated GIF, atomically.

    Args:
        figure: Figure of `moving_picture`, with all static content.
        moving: Artists that move.
        moments: At least one moment; each gives a frame.
        show: Updates the artists for a moment.
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
    palette = _palette(frames[len(frames) // 2])  # the same artists move in all frames
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
