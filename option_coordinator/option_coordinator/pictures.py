"""Pictures of an episode: a timeline of who runs which option, and a replay of it as an animation."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.drawing import save_figure
from ctrl_rl_core.whole_file import write_whole
from matplotlib import colormaps
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from option_coordinator.errors import OptionError
from option_coordinator.event_driven import OptionEnvironment
from option_coordinator.trace import Span

_FRAME_MILLISECONDS = 120
_LABEL_CHARACTER = 0.011
"""Width of a letter, as part of the picture's."""


def draw_timeline(environment: OptionEnvironment, title: str, path: Path) -> None:
    """Draw who ran which option when in an environment's last episode, as Fig. 5.1 does; pale if it was not finished.

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
    write_whole(path, content.getvalue())


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
    """Draw who ran which option when, a row for each agent; pale if it was not finished.

    Args:
        ax: to draw on.
        spans: what ran.
        agents: names, from top to bottom.
        options: names of all, for their colours.
        unit: of a span's times [s].
    """
    rows = {agent: row for row, agent in enumerate(reversed(agents))}
    palette = colormaps["tab20"]
    colours = {name: palette((index % 20) / 20.0 + 0.025) for index, name in enumerate(sorted(set(options)))}
    length = max(span.end for span in spans)
    for span in spans:
        _draw_span(ax, span, rows[span.agent], colours[span.option], unit, length)
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


def _draw_span(ax: Axes, span: Span, row: int, colour: Any, unit: float, length: float) -> None:
    left, width = span.begin * unit, (span.end - span.begin) * unit
    ax.barh(row, width, left=left, height=0.8, color=colour, edgecolor="w", alpha=0.9 if span.finished else 0.35)
    if (span.end - span.begin) / length > _LABEL_CHARACTER * len(span.option):
        ax.text(left + 0.5 * width, row, span.option, ha="center", va="center", fontsize=7)
