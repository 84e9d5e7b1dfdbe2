"""What is wrong with a picture: words that leave it, cover data, or are too small."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ctrl_rl_core.plots import FULL, HALF, SMALL, covers, line_points
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
COLUMN = 688.0
"""Width of the page's column [pixels]; a picture as wide as it is has 7 inches."""


def figures_of(name: str, kind: type[Any]) -> Any:
    """Return the figures of committed results."""
    from ctrl_rl_learning.study import read_figures

    return read_figures(RESULTS / f"{name}.json", kind)


def assert_clean(drawn: Mapping[str, Sequence[str]]) -> None:
    """Assert that pictures were drawn, and nothing is wrong with them."""
    assert drawn
    assert {name: faults for name, faults in drawn.items() if faults} == {}


def faults_of(figure: Figure) -> list[str]:
    """Return what is wrong with a figure that has been laid out."""
    figure.draw_without_rendering()  # what was written may have had another resolution
    found = []
    if figure.get_figwidth() not in (FULL, HALF):
        found.append(f"is {figure.get_figwidth()} in wide, neither {FULL} nor {HALF}")
    boxes: list[tuple[str, Bbox]] = []
    points = {axes: line_points(axes) for axes in figure.axes}
    for axes, text in _texts(figure):
        box, words = text.get_window_extent(), " ".join(text.get_text().split())
        if text.get_fontsize() < SMALL:
            found.append(f"'{words}' has {text.get_fontsize():g} pt")
        outside = (box.x0 < -1, box.y0 < -1, box.x1 > figure.bbox.x1 + 1, box.y1 > figure.bbox.y1 + 1)
        if any(outside):
            found.append(f"'{words}' leaves the canvas at {outside}")
        tight = box.padded(-2.0)
        found += [f"'{words}' lies on '{other}'" for other, there in boxes if tight.overlaps(there)]
        boxes.append((words, tight))
        for other in figure.axes if axes is None else [axes]:
            if covered := covers(box, points[other]):
                found.append(f"'{words}' covers {covered} points")
    return found


def _texts(figure: Figure) -> Iterator[tuple[Axes | None, Text]]:
    """Yield every text that is seen, with the panel in which it may cover something."""
    seen: set[int] = set()
    for axes in figure.axes:
        ticks = {id(label) for axis in (axes.xaxis, axes.yaxis) for label in axis.get_ticklabels(which="both")}
        hidden = {
            id(label)
            for axis in (axes.xaxis, axes.yaxis)
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks())
            for label in (tick.label1, tick.label2)
            if not axis.get_view_interval().min() <= tick.get_loc() <= axis.get_view_interval().max()
        }
        for text in axes.findobj(Text):
            seen.add(id(text))
            if _is_seen(text, axes) and id(text) not in hidden:
                yield (None if id(text) in ticks else axes), text
    for text in figure.findobj(Text):
        if id(text) not in seen and text.get_visible() and text.get_text().strip():
            yield None, text


def _is_seen(text: Text, axes: Axes) -> bool:
    return bool((text.get_visible() and text.get_text().strip() and axes.get_visible() and axes.axison) or
                (text.get_text().strip() and text in axes.texts))  # fmt: skip
