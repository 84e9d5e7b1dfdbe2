"""Makes the README's animation: a drive by the real nodes down the time to reach; a person crosses, the filter acts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from ctrl_rl_core.plots import (
    BLACK,
    DANGER,
    draw_mover,
    draw_robot,
    draw_values,
    film,
    moving_picture,
    name_axes,
    word_at,
)
from ctrl_rl_navigation.cli import task_content
from ctrl_rl_navigation.maps import load_map, map_file
from ctrl_rl_navigation.robot import limits_of
from geometry_msgs.msg import PoseStamped
from matplotlib.patches import Circle
from rclpy.node import Node

from ctrl_rl_bringup.corridor.drive import running
from ctrl_rl_bringup.corridor.report import DriveReport, read_drive
from ctrl_rl_bringup.runner.prepare import new_run
from ctrl_rl_bringup.runner.stack import RAW, DriveConfig, NodeSpec, guards
from ctrl_rl_core import atomic_write, draw_world, find_robot, load_navigation_task
from ctrl_rl_msgs.msg import SafetyStatus
from ctrl_rl_navigation import MapSolver

MAP = "warehouse"
START, GOAL = (7.5, 0.55, np.pi / 4), (3.7, 6.8)
TOLERANCE = 0.2
"""Distance from the goal at which it is reached [m]."""
_PERSON: dict[str, Any] = {
    "radius": "0.2 m",
    "track": {"points": ["(4.6, 5.5) m", "(0.45, 5.5) m"], "speed": "0.3 .. 0.3 m/s"},
}


def drive(folder: Path, speed: float) -> DriveReport:
    """Drive once, record everything in a new folder, and return the report.

    Args:
        folder: Folder of the run, with the task's file beside it.
        speed: Simulation time per wall time.

    Raises:
        CtrlRlError: The folder exists, or the nodes do not come up.
    """
    content = task_content(map_file(MAP), START)
    x, y = GOAL
    content |= {
        "name": folder.name.replace("-", "_"),
        "goal": {"disc": {"centre": f"({x}, {y}) m", "radius": f"{TOLERANCE} m"}},
        "movers": [_PERSON],
        "episode": {"steps": 1500, "time_step": "0.1 s"},
    }
    file = (folder.parent / f"{content['name']}.yaml").resolve()
    file.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(file, yaml.safe_dump(content))
    options = DriveConfig(folder, task=str(file), speed=speed, safety_filter=True)
    new_run(options)
    navigator = NodeSpec("ctrl_rl_navigation", "navigator", {"use_sim_time": True}, (RAW,), remappings={"cmd_vel": RAW})
    with running(options, [navigator, *guards(options, load_navigation_task(options.task))], {}) as monitor:
        clicker = Node("clicker")
        goal = PoseStamped()
        goal.header.frame_id = "map"
        goal.pose.position.x, goal.pose.position.y = x, y
        clicker.create_publisher(PoseStamped, "goal_pose", 10).publish(goal)
        monitor.run()
        monitor.follow("driving")
        clicker.destroy_node()
    return read_drive(options.bag)


FRAME, FRAMES = 0.05, 200
"""Time per frame [s] and number of frames; with the last one held the animation takes 12 s."""
_CONTOURS = 5.0
_SHOWN = 0.5
"""Time before and after a changed command for which the outline is coloured [s of the drive]."""


def draw(drive: DriveReport, path: Path) -> None:
    """Write the animation of a drive.

    Args:
        drive: The drive, from `drive`.
        path: File to write.
    """
    task = load_navigation_task(drive.task)
    map_ = load_map(MAP)
    value = MapSolver(map_, limits_of(find_robot(task.robot.body)), slowest=1.0).solve(GOAL, TOLERANCE)
    rows, columns = np.array(value.times.shape)
    x = map_.origin[0] + (np.arange(columns) + 0.5) * map_.resolution
    y = map_.origin[1] + (np.arange(rows) + 0.5) * map_.resolution
    best = float(value.value(START[:2]))
    (mover,), safety = drive.movers, drive.safety_filter
    # A filter that waits for its first command changes nothing.
    acted = np.zeros(0) if safety is None else safety.times[safety.changed & (safety.modes != SafetyStatus.WAITING)]
    title = f"Rolling down the time to reach: {drive.duration:.0f} s driven, {best:.0f} s at best"
    with moving_picture(title, height=5.0) as (figure, ((ax,),)):
        times = np.where(value.times > 0.0, value.times, np.nan)
        image = draw_values(ax, x, y, times, "time", (0.0, float(np.nanmax(times[np.isfinite(times)]))), _CONTOURS)
        figure.colorbar(image, ax=ax, label="time to reach the goal [s]")
        draw_world(ax, task)
        ax.set_xlim(x[0], x[-1])
        ax.set_ylim(y[0], y[-1])
        name_axes(ax, "x", "y")
        word_at(ax, "start", START[:2])
        draw_robot(ax, START[:2], START[2], task.robot.radius)
        (driven,) = ax.plot([], [], color=BLACK, linewidth=2.0)
        person = draw_mover(ax, mover.track[:1, 1:], mover.at(0.0), mover.radius)
        body = Circle(START[:2], task.robot.radius, facecolor="white", edgecolor=BLACK, linewidth=2.0, zorder=8)
        ax.add_patch(body)
        (nose,) = ax.plot([], [], color=BLACK, linewidth=1.6, zorder=9)
        clock = ax.set_title(" ")

        def show(time: float) -> None:
            past = drive.truth[:, 0] <= max(time, float(drive.truth[0, 0]))
            places = drive.truth[past, 1:]
            here, before = places[-1], places[-min(len(places), 15)]
            turn = np.arctan2(*(here - before)[::-1]) if np.any(here != before) else START[2]
            acts = bool(np.any(np.abs(acted - time) < _SHOWN))
            driven.set_data(*places.T)
            body.set_center((float(here[0]), float(here[1])))
            body.set_edgecolor(DANGER if acts else BLACK)
            reach = task.robot.radius * np.array([np.cos(turn), np.sin(turn)])
            nose.set_data([here[0], here[0] + reach[0]], [here[1], here[1] + reach[1]])
            person.set_center(mover.at(time))
            told = ": the safety filter acts" if acts else ""
            clock.set_text(f"{time:4.1f} s, {float(value.value(here)):4.1f} s to go{told}")

        moving: list[Any] = [driven, person, body, nose, clock]
        film(figure, moving, np.linspace(0.0, drive.duration, FRAMES), show, path, FRAME)
