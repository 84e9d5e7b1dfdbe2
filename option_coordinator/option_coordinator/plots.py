"""Plots of an episode: a timeline of the options, and an animation."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.patches import Patch
from PIL import Image

from ctrl_rl_core import atomic_write, save_figure
from option_coordinator.environments.option_env import OptionEnvironment
from option_coordinator.environments.timeline import Span
from option_coordinator.errors import OptionError

_FRAME_MILLISECONDS = 120
_LABEL_SIZE = 7.0  # pt
_LETTER = 0.62 * _LABEL_SIZE
_LINE = 1.3 * _LABEL_SIZE
_SAME = 0.01  # of the picture: a gap that parts nothing


def draw_timeline(environment: OptionEnvironment, title: str, path: Path) -> None:
    """Draw the options of an environment's last episode as in Fig. 5.1; pale where an option was not finished.

    Raises:
        OptionError: there was none.
    """
    figure, ax = plt.subplots(figsize=(10.0, 0.9 + 0.45 * len(environment.agents)), layout="constrained")
    _draw_episode(ax, environment)
    ax.set_title(title, fontsize=10)
    save_figure(figure, path)


def draw_replay(environment: OptionEnvironment, title: str, path: Path) -> None:
    """Draw a filmed environment's last episode as an animated GIF: the room above, the timeline below.

    Raises:
        OptionError: there was none, or it was not filmed.
    """
    if not environment.scenes:
        raise OptionError("the episode was not filmed: make the environment with film=True")
    figure, (room, line) = plt.subplots(
        2, 1, figsize=(7.0, 6.0), dpi=80, height_ratios=(3, 1.2), layout="constrained", squeeze=True
    )
    _draw_episode(line, environment)
    now = line.axvline(0.0, color="k", linewidth=1.0)
    bodies = _draw_room(room, environment)
    canvas = FigureCanvasAgg(figure)
    frames: list[Image.Image] = []
    for step, scene in enumerate(environment.scenes):
        for name, body in bodies.items():
            body.set_data([scene.robots[name][0]], [scene.robots[name][1]])
        now.set_xdata([step * environment.simulation.time_step] * 2)
        room.set_title(f"{title}\n{scene.note}", fontsize=9)
        canvas.draw()  # type: ignore[no-untyped-call]
        figure.set_layout_engine("none")  # found once: finding it takes longer than drawing
        pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        frames.append(Image.fromarray(pixels[..., :3]))
    plt.close(figure)
    content = BytesIO()
    first, *others = _with_few_colours(frames)
    first.save(content, "GIF", save_all=True, append_images=others, duration=_FRAME_MILLISECONDS, loop=0)
    atomic_write(path, content.getvalue())


def _with_few_colours(frames: Sequence[Image.Image]) -> list[Image.Image]:
    """Return pictures in the first one's 256 colours: the same things move in all of them."""
    first = frames[0].quantize()
    return [first, *(frame.quantize(palette=first, dither=Image.Dither.NONE) for frame in frames[1:])]


def _draw_room(ax: Axes, environment: OptionEnvironment) -> dict[str, Any]:
    """Draw what does not move and return the robots' marks by name."""
    simulation = environment.simulation
    for name, place in simulation.landmarks.items():
        ax.plot(*place, "s", color="0.6")
        ax.annotate(name, place, textcoords="offset points", xytext=(0, 7), ha="center", fontsize=8, color="0.4")
    colours = plt.rcParams["axes.prop_cycle"].by_key()["color"]
    bodies = {}
    for agent, colour in zip(environment.agents, colours, strict=False):
        (bodies[agent.name],) = ax.plot([], [], "o", markersize=12, color=colour, alpha=0.8, label=agent.name)
    ax.set_xlim(simulation.room[0])
    ax.set_ylim(simulation.room[1])
    ax.set_aspect("equal")
    ax.set_xlabel("x [m]")
    ax.set_ylabel("y [m]")
    ax.legend(fontsize=8, loc="upper right")
    return bodies


def draw_spans(
    ax: Axes, spans: Sequence[Span], agents: Sequence[str], options: Sequence[str], unit: float = 1.0
) -> None:
    """Draw the options that agents ran, a row for each agent; pale where an option was not finished.

    Repeated options are labelled once; options without room for a label are listed in a legend.

    Args:
        ax: Axes to draw on.
        spans: Runs of options to draw.
        agents: Names of the agents, from top to bottom.
        options: Names of all options, which set their colours.
        unit: Duration of one unit of a span's times [s].
    """
    rows = {agent: row for row, agent in enumerate(reversed(agents))}
    palette = colormaps["tab20"]
    colours = {name: palette((index % 20) / 20.0 + 0.025) for index, name in enumerate(sorted(set(options)))}
    length = max(span.end for span in spans)
    for span in spans:
        left, width = span.begin * unit, (span.end - span.begin) * unit
        colour, alpha = colours[span.option], 0.9 if span.finished else 0.35
        ax.barh(rows[span.agent], width, left=left, height=0.8, color=colour, edgecolor="w", alpha=alpha)
    points = 72.0 / ax.figure.dpi
    point, room = length / (ax.bbox.width * points), 0.8 * ax.bbox.height * points / len(rows)
    nameless = {span.option for span in spans}
    for span in _stretches(spans, _SAME * length):
        rotation = _rotation(len(span.option) * _LETTER, (span.end - span.begin) / point, room)
        if rotation is not None:
            at = 0.5 * (span.begin + span.end) * unit, rows[span.agent]
            ax.text(*at, span.option, ha="center", va="center", fontsize=_LABEL_SIZE, rotation=rotation)
            nameless.discard(span.option)
    if nameless:
        handles = [Patch(color=colours[name], label=name) for name in sorted(nameless)]
        ax.legend(handles=handles, fontsize=_LABEL_SIZE, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    ax.set_yticks(list(rows.values()), list(rows))
    ax.set_ylim(-0.5, len(rows) - 0.5)
    ax.set_xlim(0.0, length * unit)
    ax.set_xlabel("time [s]")


def _draw_episode(ax: Axes, environment: OptionEnvironment) -> None:
    if not environment.trace.spans:
        raise OptionError("there is no episode to draw: play one first")
    options = [option for agent in environment.agents for option in agent.options]
    names = [agent.name for agent in environment.agents]
    draw_spans(ax, environment.trace.spans, names, options, environment.simulation.time_step)


def _stretches(spans: Sequence[Span], gap: float) -> list[Span]:
    """Return spans with those as one in which an agent runs the same option again and again."""
    out: list[Span] = []
    for span in sorted(spans, key=lambda span: (span.agent, span.begin)):
        last = out[-1] if out else None
        if last is not None and last[:2] == span[:2] and span.begin - last.end <= gap:
            out[-1] = last._replace(end=span.end)
        else:
            out.append(span)
    return out


def _rotation(length: float, width: float, height: float) -> float | None:
    """Return how a label is turned [deg] so that it fits, None where it does not; sizes in points."""
    if length + _LETTER <= width:
        return 0.0
    return 90.0 if width >= _LINE and length <= height else None
