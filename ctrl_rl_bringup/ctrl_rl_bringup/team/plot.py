"""The picture of a team's run: where the robots drove, and who ran which option when."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path

from ctrl_rl_core.plots import ROBOTS, draw_landmark, name_at_end
from option_coordinator.plots import draw_spans

from ctrl_rl_bringup.team.report import TeamRun
from ctrl_rl_core import NavigationTask, draw_map, draw_path, picture
from option_coordinator import TeamFile


def draw_team(run: TeamRun, task: NavigationTask, team: TeamFile, path: Path) -> None:
    """Write the picture atomically."""
    done = "all work done" if run.finished else "cut off"
    title = f"{team.name}, policy {run.policy}: {done} after {run.duration:.0f} s"
    with picture(path, title, 2, 1, height=6.0, height_ratios=(2, 1)) as (figure, ((room,), (line,))):
        draw_map(room, task)
        for name, option in team.options.items():
            if option.station is not None:
                draw_landmark(room, name, option.station)
        for (robot, points), colour in zip(run.paths.items(), cycle(ROBOTS), strict=False):
            draw_path(room, points, colour=colour)
            name_at_end(room, robot, float(points[-1, 1]), colour)
        figure.draw_without_rendering()  # labels are as large as their bars
        draw_spans(line, run.spans, run.agents, tuple(team.options))
