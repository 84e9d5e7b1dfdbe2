"""The pictures of a drive: its path over the task's walls, what happened over time, and an animation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.plots import (
    BLACK,
    DANGER,
    SKY,
    Series,
    draw_mover,
    draw_robot,
    draw_series,
    film,
    map_beside,
    mark_clearance,
    moving_picture,
    name_axes,
    word_at,
)
from ctrl_rl_core.ros import seconds
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from numpy.typing import NDArray

from ctrl_rl_bags import BagError, read_messages
from ctrl_rl_bringup.corridor.report import DriveReport
from ctrl_rl_bringup.runner.monitor import OUTCOMES
from ctrl_rl_core import NavigationTask, draw_path, draw_world, load_navigation_task, picture

_COMMANDS = {"xy": ("speed [m/s]", "turn rate [rad/s]"), "xz": ("$T_1$ [N]", "$T_2$ [N]")}
"""Names of the two commands, by plane."""


def draw_drive(drive: DriveReport, path: Path) -> None:
    """Write the path with clearance and commands, and the recorded values beside it as values.svg."""
    task = load_navigation_task(drive.task)
    title = f"{task.name}: {OUTCOMES[drive.outcome]} after {drive.duration:.1f} s, never nearer than "
    title += f"{drive.smallest_clearance:.2f} m to a wall or an obstacle"
    with picture(path, title, 3, 2, height=4.4, width_ratios=(1.4, 1)) as (_, axes):
        ground = map_beside(axes)
        _draw_map(ground, task, drive)
        safety = drive.safety_filter
        acted = None if safety is None else (safety.times, safety.changed)
        series = [Series("clearance [m]", drive.clearance[:, 0], drive.clearance[:, 1], limit=0.0)]
        for column, name in enumerate(_COMMANDS[task.plane], 1):
            raw = None if safety is None else (safety.times, safety.raw[:, column - 1])
            series.append(Series(name, drive.commands[:, 0], drive.commands[:, column], raw, steps=True))
        draw_series(axes[:, 1], series, drive.duration, acted)
    values = _values(drive)
    if values:
        file = path.with_name("values.svg")
        with picture(file, f"{task.name}: values on the way", len(values), height=1.0 + 1.2 * len(values)) as (_, axes):
            draw_series(axes[:, 0], values, drive.duration)


def _values(drive: DriveReport) -> list[Series]:
    """Return the recorded values and prediction errors as series."""
    out = []
    if len(drive.rewards):
        best = np.array([0.0, drive.time_to_reach])
        out.append(
            Series("time to reach [s]; dotted: at best", drive.rewards[:, 0], drive.rewards[:, 2], (best, best[::-1]))
        )
    if len(drive.oc_values):
        out.append(Series("optimal value", drive.oc_values[:, 0], drive.oc_values[:, 1]))
    if len(drive.predictions):
        times, error, still = drive.predictions.T
        out.append(Series("one-step error; dotted: of 'nothing changes'", times, error, (times, still)))
    return out


def _draw_map(axes: Axes, task: NavigationTask, drive: DriveReport) -> None:
    draw_world(axes, task, drive.width)
    times, places = drive.truth[:, 0], drive.truth[:, 1:3]
    if len(places) > 1:
        draw_path(axes, places, times=times)
        radius, flies = task.robot.radius, task.plane == "xz"
        draw_robot(axes, places[0], _heading(places), radius, flies=flies)
        word_at(axes, "start", (float(places[0, 0]), float(places[0, 1])))
    if len(places) > 1 and len(drive.clearance):
        moment, least = drive.clearance[np.argmin(drive.clearance[:, 1])]
        mark_clearance(axes, [np.interp(moment, times, column) for column in places.T], float(least))
    for mover in drive.movers:
        driven = mover.track[mover.track[:, 0] <= drive.duration]
        distances = [
            np.hypot(*(np.array(mover.at(time)) - [np.interp(time, times, column) for column in places.T]))
            for time in driven[:, 0]
        ]
        nearest = driven[int(np.argmin(distances)), 0] if distances else 0.0
        draw_mover(axes, driven[:, 1:], mover.at(float(nearest)), mover.radius)
    name_axes(axes, "x", task.plane[1])
    axes.autoscale_view()


def _heading(places: NDArray[np.float64]) -> float:
    """Return the direction in which a path (n, 2) begins [rad]."""
    far = places[np.linalg.norm(places - places[0], axis=1) > 0.05]
    step = (far[0] if len(far) else places[-1]) - places[0]
    return float(np.arctan2(step[1], step[0]))


Array = NDArray[np.float64]
_TRUTH = "/ground_truth"
_LONGEST = 10.0
"""Maximum duration of an animation [s]; longer drives are shown faster."""
_FRAME = 0.06


def animate_drive(bag: Path, drive: DriveReport, path: Path) -> None:
    """Write a drive as an animated GIF, atomically, with one frame per scan.

    Args:
        bag: Folder of the bag.
        drive: The same drive, as `read_drive` returns it.
        path: File to write.

    Raises:
        BagError: The bag has no scans or no robot poses.
    """
    poses, scans = _read(bag)
    task = load_navigation_task(drive.task)
    begin = poses[0, 0] - drive.truth[0, 0]
    with moving_picture(" ", 3, 2, height=3.7, width_ratios=(1.7, 1)) as (figure, axes):
        ground = map_beside(axes)
        draw_world(ground, task, drive.width)
        name_axes(ground, "x", task.plane[1])
        ground.autoscale_view()
        (echoes,) = ground.plot([], [], ".", color=SKY, markersize=2.5)
        (driven,) = ground.plot([], [], color=BLACK, linewidth=2)
        body = Circle((0.0, 0.0), task.robot.radius, facecolor="white", edgecolor=BLACK, linewidth=1.2)
        movers = [Circle(mover.at(0.0), mover.radius, color=DANGER, linewidth=0) for mover in drive.movers]
        for circle in (body, *movers):
            ground.add_patch(circle)
        (nose,) = ground.plot([], [], color=BLACK, linewidth=1.2)
        clock = ground.set_title(" ")
        draw_series(axes[:, 1], _series(drive), drive.duration)
        marks = [ax.axvline(0.0, color=BLACK, linewidth=1) for ax in axes[:, 1]]

        def show(scan: tuple[float, Array, Array]) -> None:
            stamp, bearings, ranges = scan
            time = stamp - begin
            x, y, yaw = (np.interp(stamp, poses[:, 0], column) for column in poses[:, 1:].T)
            seen = np.isfinite(ranges)
            turned = yaw + bearings[seen]
            echoes.set_data(x + ranges[seen] * np.cos(turned), y + ranges[seen] * np.sin(turned))
            driven.set_data(*drive.truth[drive.truth[:, 0] <= time, 1:].T)
            body.set_center((x, y))
            nose.set_data([x, x + body.radius * np.cos(yaw)], [y, y + body.radius * np.sin(yaw)])
            for circle, mover in zip(movers, drive.movers, strict=True):
                circle.set_center(mover.at(time))
            clock.set_text(f"{time:4.1f} s")
            for mark in marks:
                mark.set_xdata([time, time])

        kept = scans[:: max(1, round(len(scans) * _FRAME / _LONGEST))]
        film(figure, (echoes, driven, body, nose, clock, *marks, *movers), kept, show, path, _FRAME)


def _read(bag: Path) -> tuple[Array, list[tuple[float, Array, Array]]]:
    """Return poses (n, 4: stamp [s], x [m], y [m], heading [rad]) and scans (stamp [s], bearings [rad], ranges [m])."""
    poses: list[tuple[float, float, float, float]] = []
    scans: list[tuple[float, Array, Array]] = []
    for message in read_messages(bag, [_TRUTH, "/scan"]):
        data: Any = message.data
        stamp = seconds(data.header.stamp)
        if message.topic == _TRUTH:
            position, turn = data.pose.pose.position, data.pose.pose.orientation
            poses.append((stamp, position.x, position.y, 2.0 * np.arctan2(turn.z, turn.w)))
        else:
            ranges = np.asarray(data.ranges, dtype=float)
            bearings = data.angle_min + data.angle_increment * np.arange(len(ranges))
            valid = (ranges >= data.range_min) & (ranges < data.range_max)
            scans.append((stamp, bearings, np.where(valid, ranges, np.nan)))
    if not poses or not scans:
        raise BagError(f"{bag}: an animation needs {_TRUTH} and /scan, which a demo records")
    track = np.array(poses)
    track[:, 3] = np.unwrap(track[:, 3])
    return track, scans


def _series(drive: DriveReport) -> list[Series]:
    """Return the commands, and the time to reach if it was recorded, else the clearance."""
    times, speeds, turns = drive.commands.T
    reach = (
        Series("time to reach [s]", *drive.rewards[:, [0, 2]].T)
        if len(drive.rewards)
        else Series("clearance [m]", *drive.clearance.T)
    )
    return [
        Series("speed [m/s]", times, speeds, steps=True),
        Series("turn rate [rad/s]", times, turns, steps=True),
        reach,
    ]
