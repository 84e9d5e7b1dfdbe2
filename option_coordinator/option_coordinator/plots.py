"""Plots of an episode: a timeline of the options, and an animation."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

from ctrl_rl_core.plots import (
    BLACK,
    ROBOTS,
    SMALL,
    draw_landmark,
    film,
    greys,
    legend_below,
    moving_picture,
    name_axes,
    write_small,
)
from matplotlib.axes import Axes

from ctrl_rl_core import picture
from option_coordinator.environments.option_env import OptionEnvironment, Span
from option_coordinator.errors import OptionError

_FRAME_TIME = 0.12
_LETTER, _LINE = 0.62, 1.3  # relative to the font size
_SAME = 0.01  # relative to the figure; smaller gaps are not drawn


def draw_timeline(environment: OptionEnvironment, title: str, path: Path) -> None:
    """Draw the options of an environment's last episode as in Fig. 5.1; unfinished options are hatched.

    Raises:
        OptionError: No episode was played.
    """
    with picture(path, title, height=1.4 + 0.45 * len(environment.agents)) as (figure, ((ax,),)):
        figure.draw_without_rendering()  # labels are scaled with their bars
        _draw_episode(ax, environment)


def draw_replay(environment: OptionEnvironment, title: str, path: Path) -> None:
    """Draw a filmed environment's last episode as an animated GIF: room above, timeline below.

    Raises:
        OptionError: No episode was played, or it was not filmed.
    """
    if not environment.scenes:
        raise OptionError("the episode was not filmed: make the environment with film=True")
    with moving_picture(title, 2, 1, height=6.4, height_ratios=(3, 1.2)) as (figure, ((room,), (line,))):
        _draw_episode(line, environment)
        now = line.axvline(0.0, color=BLACK, linewidth=1.0)
        bodies = _draw_room(room, environment)
        legend_below(figure, len(bodies))
        note = room.set_title(" ")

        def show(step: int) -> None:
            scene = environment.scenes[step]
            for name, body in bodies.items():
                body.set_data([scene.robots[name][0]], [scene.robots[name][1]])
            now.set_xdata([step * environment.simulation.time_step] * 2)
            note.set_text(scene.note)

        film(figure, (*bodies.values(), now, note), range(len(environment.scenes)), show, path, _FRAME_TIME)


def _draw_room(ax: Axes, environment: OptionEnvironment) -> dict[str, Any]:
    """Draw the static parts and return the robots' markers by name."""
    simulation = environment.simulation
    for name, place in simulation.landmarks.items():
        draw_landmark(ax, name, place)
    bodies = {}
    for agent, colour in zip(environment.agents, cycle(ROBOTS), strict=False):
        (bodies[agent.name],) = ax.plot([], [], "o", markersize=12, color=colour, markeredgecolor=BLACK,
                                        label=agent.name)  # fmt: skip
    ax.set_xlim(simulation.room[0])
    ax.set_ylim(simulation.room[1])
    name_axes(ax, "x", "y")
    return bodies


def draw_spans(
    ax: Axes, spans: Sequence[Span], agents: Sequence[str], options: Sequence[str], unit: float = 1.0
) -> None:
    """Draw the options that agents ran, one row per agent; unfinished options are hatched.

    Repeated options are labelled once; options without room for a label get a number, explained at the axis.

    Args:
        ax: Axes to draw on.
        spans: Runs of options to draw.
        agents: Names of the agents, from top to bottom.
        options: Names of all options, which set their shades.
        unit: Duration of one unit of a span's times [s].
    """
    rows = {agent: row for row, agent in enumerate(reversed(agents))}
    names = sorted(set(options))
    shades = dict(zip(names, greys(len(names)), strict=True))
    length = max(span.end for span in spans)
    for span in spans:
        left, width = span.begin * unit, (span.end - span.begin) * unit
        ax.barh(rows[span.agent], width, left=left, height=0.8, facecolor=shades[span.option], edgecolor="white",
                hatch=None if span.finished else "///")  # fmt: skip
    points = 72.0 / ax.figure.dpi
    point, room = length / (ax.bbox.width * points), 0.8 * ax.bbox.height * points / len(rows)
    numbers: dict[str, int] = {}
    for span in _stretches(spans, _SAME * length):
        label, wide = span.option, (span.end - span.begin) / point
        rotation = _rotation(len(label) * _LETTER * SMALL, wide, room)
        if rotation is None:
            label = str(numbers.setdefault(span.option, len(numbers) + 1))
            rotation = _rotation(len(label) * _LETTER * SMALL, wide, room)
        if rotation is not None:
            at = 0.5 * (span.begin + span.end) * unit, rows[span.agent]
            write_small(ax, label, at, rotation)
    ax.set_yticks(list(rows.values()), list(rows))
    ax.set_ylim(-0.5, len(rows) - 0.5)
    ax.set_xlim(0.0, length * unit)
    ax.grid(visible=False)
    key = ", ".join(f"{number} {name}" for name, number in numbers.items())
    ax.set_xlabel("time [s]" + (f"\n{textwrap.fill(key, 90)}" if key else ""))


def _draw_episode(ax: Axes, environment: OptionEnvironment) -> None:
    if not environment.trace.spans:
        raise OptionError("there is no episode to draw: play one first")
    options = [option for agent in environment.agents for option in agent.options]
    names = [agent.name for agent in environment.agents]
    draw_spans(ax, environment.trace.spans, names, options, environment.simulation.time_step)


def _stretches(spans: Sequence[Span], gap: float) -> list[Span]:
    """Merge consecutive spans in which an agent repeats the same option."""
    out: list[Span] = []
    for span in sorted(spans, key=lambda span: (span.agent, span.begin)):
        last = out[-1] if out else None
        if last is not None and last[:2] == span[:2] and span.begin - last.end <= gap:
            out[-1] = last._replace(end=span.end)
        else:
            out.append(span)
    return out


def _rotation(length: float, width: float, height: float) -> float | None:
    """Return the rotation [deg] at which a label fits, or None; sizes in points."""
    if length + _LETTER * SMALL <= width:
        return 0.0
    return 90.0 if width >= _LINE * SMALL and length <= height else None
