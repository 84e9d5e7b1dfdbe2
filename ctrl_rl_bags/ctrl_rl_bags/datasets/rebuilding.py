"""Writes bags from frames; `extraction` recovers the same frames bit for bit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
    DatasetError,
    Frames,
    Layout,
    ScanLayout,
)
from ctrl_rl_bags.format.metadata import Topic
from ctrl_rl_bags.format.writer import BagWriter
from ctrl_rl_bags.recording.message_types import message_definition, typestore

SCAN_TYPE, ODOMETRY_TYPE = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
GOAL_TYPE, IMAGE_TYPE = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/Image"
REWARD_TYPE, EPISODE_TYPE = "ctrl_rl_msgs/msg/TaskReward", "ctrl_rl_msgs/msg/EpisodeStatus"
_OWN = (REWARD_TYPE, EPISODE_TYPE, "ctrl_rl_msgs/msg/RotorThrusts")


class MessageMaker:
    """Creates the CDR bytes of messages.

    Args:
        odometry_frame: Frame name of odometry and goals.
        body_frame: Frame name of the robot's body.
    """

    def __init__(self, odometry_frame: str = "odom", body_frame: str = "base_footprint") -> None:
        self._store = typestore(*_OWN)
        self._odometry_frame, self._body_frame = odometry_frame, body_frame
        self._no_covariance = np.zeros(36)
        self._no_intensities = np.empty(0, np.float32)

    def topic(self, name: str, kind: str) -> Topic:
        """Return a topic with the definition and hash of its type."""
        return Topic(name, kind, message_definition(kind), self._store.hash_rihs01(kind))

    def scan(self, stamp: int, ranges: NDArray[np.float32], layout: ScanLayout) -> bytes:
        """Create a LaserScan from ranges (beams,) [m]."""
        return self._bytes(
            SCAN_TYPE,
            self._header(stamp, layout.frame or self._body_frame),
            layout.angle_min,
            layout.angle_min + layout.angle_increment * (layout.beams - 1),
            layout.angle_increment,
            0.0,
            0.0,
            layout.range_min,
            layout.range_max,
            np.ascontiguousarray(ranges),
            self._no_intensities,
        )

    def odometry(self, stamp: int, numbers: ArrayLike) -> bytes:
        """Create an Odometry from pose and twist (13,), see `ODOMETRY_NAMES`."""
        it = np.asarray(numbers, dtype=np.float64).tolist()
        types = self._store.types
        pose = types["geometry_msgs/msg/PoseWithCovariance"](self._pose(it[:3], it[3:7]), self._no_covariance)
        twist = types["geometry_msgs/msg/TwistWithCovariance"](self._twist(it[7:10], it[10:]), self._no_covariance)
        return self._bytes(ODOMETRY_TYPE, self._header(stamp, self._odometry_frame), self._body_frame, pose, twist)

    def command(self, stamp: int, command: ArrayLike, kind: str) -> bytes:
        """Create a command message of type `kind`, one of `COMMAND_TYPES`, from a command (2,)."""
        first, second = np.asarray(command, dtype=np.float64).tolist()
        if kind.endswith("RotorThrusts"):
            return self._bytes(kind, self._header(stamp, self._body_frame), first, second)
        twist = self._twist((first, 0.0, 0.0), (0.0, 0.0, second))
        if kind.endswith("TwistStamped"):
            return self._bytes(kind, self._header(stamp, self._body_frame), twist)
        return bytes(self._store.serialize_cdr(twist, kind))

    def goal(self, stamp: int, goal: ArrayLike) -> bytes:
        """Create a PoseStamped from position and attitude (7,), see `GOAL_NAMES`."""
        it = np.asarray(goal, dtype=np.float64).tolist()
        return self._bytes(GOAL_TYPE, self._header(stamp, self._odometry_frame), self._pose(it[:3], it[3:]))

    def reward(self, stamp: int, reward: float, outcome: int) -> bytes:
        """Create a TaskReward with an unknown time to reach."""
        return self._bytes(
            REWARD_TYPE, self._header(stamp, self._odometry_frame), self._outcome(outcome), reward, float("nan")
        )

    def episode(self, stamp: int, number: int, outcome: int, seed: int = 0, elapsed: float = 0.0) -> bytes:
        """Create an EpisodeStatus with unknown clearance and progress."""
        nothing = float("nan")
        return self._bytes(
            EPISODE_TYPE,
            self._header(stamp, self._odometry_frame),
            number,
            seed,
            elapsed,
            *(nothing, nothing, nothing),
            self._outcome(outcome),
        )

    def image(self, stamp: int, picture: NDArray[np.uint8]) -> bytes:
        """Create an Image from an array (height, width, 3) in RGB order."""
        height, width, _ = picture.shape
        data = np.ascontiguousarray(picture).reshape(-1)
        return self._bytes(IMAGE_TYPE, self._header(stamp, "camera"), height, width, "rgb8", 0, 3 * width, data)

    def _bytes(self, kind: str, *fields: Any) -> bytes:
        return bytes(self._store.serialize_cdr(self._store.types[kind](*fields), kind))

    def _header(self, stamp: int, frame: str) -> Any:
        types = self._store.types
        time = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
        return types["std_msgs/msg/Header"](time, frame)

    def _outcome(self, outcome: int) -> Any:
        return self._store.types["ctrl_rl_msgs/msg/TaskOutcome"](value=outcome)

    def _pose(self, position: Any, orientation: Any) -> Any:
        types = self._store.types
        return types["geometry_msgs/msg/Pose"](
            types["geometry_msgs/msg/Point"](*position), types["geometry_msgs/msg/Quaternion"](*orientation)
        )

    def _twist(self, linear: Any, angular: Any) -> Any:
        vector, kind = self._store.types["geometry_msgs/msg/Vector3"], self._store.types["geometry_msgs/msg/Twist"]
        return kind(vector(*linear), vector(*angular))


_LATEST = 2**62


def rebuild(frames: Iterator[Frames], layout: Layout, folder: Path, robot: str) -> tuple[int, int, int]:
    """Write bags `bag_0`, `bag_1` ... to a folder; return the numbers of episodes, frames and bytes.

    Raises:
        DatasetError: Times of the frames do not increase.
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
    """Writes frames as a bag.

    Args:
        folder: Folder of the bag, which must not exist.
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
        """Append frames, episode by episode.

        Raises:
            DatasetError: Their times do not increase.
            BagError: Writing fails.
        """
        columns: dict[str, Any] = dict(frames.columns)
        for row, (time, stamp) in enumerate(zip(columns[LOG_TIME].tolist(), columns[STAMP].tolist(), strict=True)):
            if not (self._time < time < _LATEST and 0 <= stamp < _LATEST):
                raise DatasetError(f"episode {frames.episode}: the time {time} ns follows {self._time} ns")
            self._write_row(columns, row, time, stamp, frames.episode)
        if frames.last:
            self._began = None

    def close(self) -> int:
        """Finish the bag and return the total size of its messages [bytes]; may be called twice."""
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
