"""The picture of a team's run: where the robots drove, and who ran which option when."""

from __future__ import annotations

from pathlib import Path

from matplotlib import pyplot as plt
from option_coordinator.plots import draw_spans

from ctrl_rl_bringup.team.report import TeamRun
from ctrl_rl_core import NavigationTask, draw_map, save_figure
from option_coordinator import TeamFile


def draw_team(run: TeamRun, task: NavigationTask, team: TeamFile, path: Path) -> None:
    """Write the picture as a PNG; the file is there whole or not at all."""
    figure, (room, line) = plt.subplots(2, 1, figsize=(10, 8), height_ratios=(2, 1), layout="constrained")
    draw_map(room, task)
    places = {name: option.station for name, option in team.options.items() if option.station is not None}
    for name, place in places.items():
        room.plot(*place, "s", color="0.6", markersize=9)
        room.annotate(name, place, textcoords="offset points", xytext=(0, 8), ha="center", fontsize=8)
    for robot, points in run.paths.items():
        room.plot(points[:, 0], points[:, 1], linewidth=1.5, alpha=0.8, label=robot)
    room.legend(loc="upper center", ncols=max(1, len(run.paths)), frameon=False)
    draw_spans(line, run.spans, run.agents, tuple(team.options))
    done = "all work done" if run.finished else "cut off"
    figure.suptitle(f"{team.name}, policy {run.policy}: {done} after {run.duration:.0f} s", fontweight="bold")
    save_figure(figure, path)
