"""A recorded drive as an animated GIF: the robot and its lidar echoes between the walls, its commands beside them."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.ros.node import seconds
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.patches import Circle
from numpy.typing import NDArray
from PIL import Image

from ctrl_rl_bags import BagError, read_messages
from ctrl_rl_bringup.corridor.report import DriveReport
from ctrl_rl_core import atomic_write, draw_world, load_navigation_task

Array = NDArray[np.float64]
_COLOURS = 48
_FRAME_MS = 60
_HOLD_MS = 1500
"""How long the last frame stays, so that the end is seen."""
_TRUTH = "/ground_truth"


def animate_drive(bag: Path, drive: DriveReport, path: Path) -> None:
    """Write a drive as an animated GIF with one frame for each scan; the file is there whole or not at all.

    Args:
        bag: Folder of the bag.
        drive: The same drive, as `read_drive` returns it.
        path: File to write.

    Raises:
        BagError: The bag has no scans, or does not say where the robot was.
    """
    poses, scans = _read(bag)
    figure, axes = plt.subplot_mosaic(
        [["map", "speed"], ["map", "turn"], ["map", "reach"]], width_ratios=(1.7, 1), figsize=(8.0, 4.2), dpi=80,
        layout="constrained",
    )  # fmt: skip
    begin = poses[0, 0] - drive.truth[0, 0]
    draw_world(axes["map"], load_navigation_task(drive.task), drive.width)
    axes["map"].autoscale_view()
    axes["map"].set(xlabel="x [m]", ylabel="y [m]")
    (echoes,) = axes["map"].plot([], [], ".", color="tab:red", markersize=2.5)
    (driven,) = axes["map"].plot([], [], color="tab:blue", linewidth=2)
    (robot,) = axes["map"].plot([], [], "o", color="tab:blue", markersize=9)
    (nose,) = axes["map"].plot([], [], color="white", linewidth=2)
    movers = [Circle(mover.at(0.0), mover.radius, color="tab:red", alpha=0.6, linewidth=0) for mover in drive.movers]
    for circle in movers:
        axes["map"].add_patch(circle)
    clock = axes["map"].set_title(" ", family="monospace")
    marks = [mark for name, series in _series(drive).items() for mark in _draw_series(axes[name], name, series, drive)]
    moving = (echoes, driven, robot, nose, clock, *marks, *movers)
    for artist in moving:
        artist.set_animated(True)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    still = canvas.copy_from_bbox(figure.bbox)  # type: ignore[no-untyped-call]
    frames = []
    for stamp, bearings, ranges in scans:
        time = stamp - begin
        x, y, yaw = (np.interp(stamp, poses[:, 0], column) for column in poses[:, 1:].T)
        seen = np.isfinite(ranges)
        echoes.set_data(
            x + ranges[seen] * np.cos(yaw + bearings[seen]), y + ranges[seen] * np.sin(yaw + bearings[seen])
        )
        driven.set_data(*drive.truth[drive.truth[:, 0] <= time, 1:].T)
        robot.set_data([x], [y])
        nose.set_data([x, x + 0.1 * np.cos(yaw)], [y, y + 0.1 * np.sin(yaw)])
        for circle, mover in zip(movers, drive.movers, strict=True):
            circle.set_center(mover.at(time))
        clock.set_text(f"{time:4.1f} s")
        for mark in marks:
            mark.set_xdata([time, time])
        canvas.restore_region(still)  # type: ignore[no-untyped-call]
        for artist in moving:
            figure.draw_artist(artist)
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))  # type: ignore[no-untyped-call]
    plt.close(figure)
    _save(frames, path)


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


def _series(drive: DriveReport) -> dict[str, tuple[str, Array]]:
    """Return label and values (n, 2: time [s], value) of each plot beside the map, by the name of its axes."""
    out = {"speed": ("speed [m/s]", drive.commands[:, :2]), "turn": ("turn rate [rad/s]", drive.commands[:, [0, 2]])}
    reach = (
        ("time to reach [s]", drive.rewards[:, [0, 2]]) if len(drive.rewards) else ("clearance [m]", drive.clearance)
    )
    return {**out, "reach": reach}


def _draw_series(axes: Axes, name: str, series: tuple[str, Array], drive: DriveReport) -> Iterator[Any]:
    """Draw a series over time and yield the line that marks the present."""
    colours = {"speed": "tab:green", "turn": "tab:orange", "reach": "tab:purple"}
    label, values = series
    axes.step(*values.T, where="post", color=colours[name], linewidth=1.2)
    axes.set_title(label, fontsize=9, loc="left")
    axes.set_xlim(0.0, max(drive.duration, 1e-3))
    axes.tick_params(labelsize=8)
    if name == "reach":
        axes.set_xlabel("time [s]", fontsize=8)
    yield axes.axvline(0.0, color="black", linewidth=1)


def _save(frames: list[Image.Image], path: Path) -> None:
    """Write frames as a GIF in few colours, those of the middle frame: the same things move in all of them."""
    palette = frames[len(frames) // 2].quantize(_COLOURS)
    first, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    content = BytesIO()
    durations = [_FRAME_MS] * len(others) + [_HOLD_MS]
    first.save(content, "GIF", save_all=True, append_images=others, duration=durations, loop=0, optimize=True)
    atomic_write(path, content.getvalue())
