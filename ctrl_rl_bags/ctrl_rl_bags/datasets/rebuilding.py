"""Bags from frames: the messages from which `extraction` makes the same frames again, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ctrl_rl_bags.datasets.errors import DatasetError
from ctrl_rl_bags.datasets.frames import (
    ACTION,
    GOAL,
    IMAGE,
    IS_LAST,
    LOG_TIME,
    ODOMETRY,
    OUTCOME,
    REWARD,
    SCAN,
    STAMP,
    Frames,
    Layout,
)
from ctrl_rl_bags.datasets.messages import (
    EPISODE_TYPE,
    GOAL_TYPE,
    IMAGE_TYPE,
    ODOMETRY_TYPE,
    REWARD_TYPE,
    SCAN_TYPE,
    MessageMaker,
)
from ctrl_rl_bags.format.writer import BagWriter

_LATEST = 2**62


def rebuild(frames: Iterator[Frames], layout: Layout, folder: Path, robot: str) -> tuple[int, int, int]:
    """Write bags `bag_0` and so on into a folder; return their episodes, frames and bytes of messages.

    Raises:
        DatasetError: Times of the frames do not rise.
        BagError: A bag cannot be written.
    """
    source, writer = -1, None
    episodes = count = size = 0
    try:
        for piece in frames:
            if writer is None or piece.source != source:
                if writer is not None:
                    size += writer.close()
                source, writer = piece.source, DriveWriter(folder / f"bag_{piece.source}", layout, robot)
            writer.write(piece)
            episodes += piece.last
            count += len(piece)
        if writer is not None:
            size += writer.close()
    finally:
        if writer is not None:
            writer.close()
    return episodes, count, size


class DriveWriter:
    """Writes a bag of drives from frames.

    Args:
        folder: The bag, which must not exist.
        layout: Layout of the frames.
        robot: Namespace of the topics.
    """

    def __init__(self, folder: Path, layout: Layout, robot: str = "") -> None:
        self._layout, self._make = layout, MessageMaker()
        prefix = f"/{robot.strip('/')}" if robot else ""
        command = layout.command_topic.rpartition("/")[2]
        self._names = {name: f"{prefix}/{name}" for name in ("scan", "odom", "episode", "goal_pose", "reward")}
        self._names |= {"command": f"{prefix}/{command}", "image": f"{prefix}/camera/image_raw"}
        kinds = {"scan": SCAN_TYPE, "odom": ODOMETRY_TYPE, "episode": EPISODE_TYPE, "command": layout.command}
        kinds |= {"goal_pose": GOAL_TYPE} if layout.goal else {}
        kinds |= {"reward": REWARD_TYPE} if layout.reward else {}
        kinds |= {"image": IMAGE_TYPE} if layout.image is not None else {}
        self._writer = BagWriter(folder)
        for name, kind in kinds.items():
            self._writer.add_topic(self._make.topic(self._names[name], kind))
        for key, text in {"task": layout.task, **layout.digests}.items():
            self._writer.set_custom_data(key, text)
        self._time = 0
        self._began: int | None = None
        self._paid: tuple[float, int] = (np.nan, 0)
        self._goal: bytes = b""

    def write(self, frames: Frames) -> None:
        """Append frames; those of an episode follow each other.

        Raises:
            DatasetError: Their times do not rise.
            BagError: The disk refuses.
        """
        columns: dict[str, Any] = dict(frames.columns)
        for row, (time, stamp) in enumerate(zip(columns[LOG_TIME].tolist(), columns[STAMP].tolist(), strict=True)):
            if not (self._time < time < _LATEST and 0 <= stamp < _LATEST):
                raise DatasetError(f"episode {frames.episode}: the time {time} ns follows {self._time} ns")
            self._write_row(columns, row, time, stamp, frames.episode)
        if frames.last:
            self._began = None

    def close(self) -> int:
        """Finish the bag and return the bytes of its messages; a second call does nothing."""
        self._writer.close()
        return self._writer.bytes_received

    def _write_row(self, columns: dict[str, Any], row: int, time: int, stamp: int, episode: int) -> None:
        layout, make, put = self._layout, self._make, self._put
        first = self._began is None
        if self._began is None:
            self._began, self._paid, self._goal = time, (np.nan, 0), b""
        reward, outcome = self._paid
        if first or outcome:
            elapsed = (time - self._began) * 1e-9
            put("episode", make.episode(stamp, episode, outcome, elapsed=elapsed), time)
        if layout.goal and columns[GOAL][row].tobytes() != self._goal:
            self._goal = columns[GOAL][row].tobytes()
            put("goal_pose", make.goal(stamp, columns[GOAL][row]), time)
        put("odom", make.odometry(stamp, columns[ODOMETRY][row]), time)
        if layout.reward and not first:
            put("reward", make.reward(stamp, reward, outcome), time)
        if layout.image is not None:
            put("image", make.image(stamp, columns[IMAGE][row]), time)
        put("scan", make.scan(stamp, columns[SCAN][row], layout.scan), time)
        if not columns[IS_LAST][row]:
            put("command", make.command(stamp, columns[ACTION][row], layout.command), time + 1)
            self._paid = float(columns[REWARD][row]), int(columns[OUTCOME][row])
        self._time = time + 1

    def _put(self, name: str, data: bytes, time: int) -> None:
        self._writer.write(self._names[name], data, time)
