"""Creates, lays out, labels and writes figures in the suite's style."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
from numpy.typing import NDArray

from ctrl_rl_core.io.atomic_write import atomic_write
from ctrl_rl_core.plots.roles import FULL, GRID, HALF, TEXT, TITLE
from ctrl_rl_core.plots.words import place_names, place_words

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

PIXELS_PER_INCH = 200
_LINE_LENGTH = 60
_RC: Any = {  # too many parameter names to spell out as a type
    "font.size": TEXT,
    "axes.titlesize": TEXT,
    "axes.titlelocation": "left",
    "figure.labelsize": TEXT,
    "figure.dpi": PIXELS_PER_INCH,
    "figure.titlesize": TITLE,
    "figure.titleweight": "bold",
    "legend.fontsize": TEXT,
    "legend.frameon": False,
    "xtick.labelsize": TEXT,
    "ytick.labelsize": TEXT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "axes.labelsize": TEXT,
    "lines.linewidth": 1.4,
    "hatch.linewidth": 0.8,
    "svg.hashsalt": "ctrl_rl",
    "image.interpolation": "nearest",
}


@contextmanager
def style() -> Iterator[None]:
    """Apply the suite's plot style within this context."""
    with mpl.rc_context(_RC):
        yield


@contextmanager
def picture(
    path: Path,
    title: str = "",
    rows: int = 1,
    columns: int = 1,
    *,
    height: float = 2.8,
    half: bool = False,
    **layout: Any,
) -> Iterator[tuple[Figure, NDArray[Any]]]:
    """Create a figure within this context; it is written atomically at the end.

    Args:
        path: File to write; its suffix selects the format, .svg for lines and .png for maps.
        title: Title; a sentence that states the finding, wrapped if long.
        rows: Number of rows of panels.
        columns: Number of panels in a row.
        height: Height of the figure [in].
        half: Whether the figure is half as wide as the page.
        layout: Further arguments for matplotlib's `subplots`, such as sharex.

    Yields:
        The figure, and its axes (rows, columns).

    Raises:
        OSError: The file cannot be written.
    """
    with style():
        figure, axes = plt.subplots(
            rows, columns, figsize=(HALF if half else FULL, height), layout="constrained", squeeze=False, **layout
        )
        try:
            yield figure, axes
            set_title(figure, title)
            save_figure(figure, path)
        finally:
            plt.close(figure)


def map_beside(axes: NDArray[Any]) -> Axes:
    """Replace a figure's left column by one panel as tall as all panels beside it."""
    figure, place = axes[0, 0].get_figure(), axes[0, 0].get_gridspec()[:, 0]
    for ax in axes[:, 0]:
        ax.remove()
    return figure.add_subplot(place)


def set_title(figure: Figure, title: str) -> None:
    """Set a figure's title: bold, left-aligned, wrapped."""
    if title.strip():
        width = int(_LINE_LENGTH * figure.get_figwidth() / FULL)
        lines = len(textwrap.wrap(title, width))
        while len(textwrap.wrap(title, width - 1)) == lines:  # avoid a last line with a single word
            width -= 1
        figure.suptitle("\n".join(textwrap.wrap(title, width)), x=0.01, horizontalalignment="left")
    elif title:
        figure.suptitle(title, x=0.01, horizontalalignment="left")


def save_figure(figure: Figure, path: Path) -> None:
    """Place the labels of a figure, write it atomically, and close it.

    Raises:
        OSError: The file cannot be written.
    """
    settle(figure)
    content, kind = BytesIO(), path.suffix.lstrip(".").lower() or "png"
    with mpl.rc_context(_RC):
        figure.savefig(content, format=kind, metadata={"Date": None} if kind == "svg" else None)
    plt.close(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, content.getvalue())


def settle(figure: Figure) -> None:
    """Lay out a figure, and move labels to where they cover nothing."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a tiny figure has no room for its panels
        figure.draw_without_rendering()
        for axes in figure.axes:
            place_names(axes)
        figure.draw_without_rendering()  # labels beside a panel take up space
        figure.set_layout_engine("none")  # later additions take up none
        for axes in figure.axes:
            place_names(axes)
            place_words(axes)


def legend_below(figure: Figure, columns: int = 3) -> None:
    """Add one legend for all panels below them."""
    found: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(name, handle)
    figure.legend(list(found.values()), list(found), loc="outside lower center", ncols=columns)
