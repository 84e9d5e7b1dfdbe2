"""Frames: one row per scan of a drive, stored in columns, episode by episode."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from ctrl_rl_core.io import Name, Number, Positive, Schema, as_text, parse_json, read_bytes
from ctrl_rl_core.sensing import MOST_BEAMS, ODOMETRY_NAMES
from numpy.typing import NDArray
from pydantic import Field

from ctrl_rl_bags.format.checks import BagError
from ctrl_rl_core import ScanGeometry

LARGEST_INFO = 16_000_000
"""Maximum size of a dataset's JSON description [bytes]."""


class DatasetError(BagError):
    """A dataset cannot be written or read; the message gives the reason."""


MEMORY = 1 << 30
"""Memory limit for reading a dataset, in addition to a multiple of its size [bytes]."""


CommandType = Literal["geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped", "ctrl_rl_msgs/msg/RotorThrusts"]
COMMAND_TYPES: Mapping[str, tuple[str, str]] = {
    "geometry_msgs/msg/Twist": ("v", "omega"),
    "geometry_msgs/msg/TwistStamped": ("v", "omega"),
    "ctrl_rl_msgs/msg/RotorThrusts": ("T_1", "T_2"),
}
"""Names of the action's components by command type: [m/s], [rad/s], or [N]."""
GOAL_NAMES = ODOMETRY_NAMES[:7]
STATE_NAMES = ("x", "y", "theta", "v", "omega")
SCAN, ODOMETRY, STATE = "observation.scan", "observation.odometry", "observation.state"
GOAL, IMAGE, ACTION = "observation.goal", "observation.image", "action"
REWARD, OUTCOME, DONE, IS_LAST = "next.reward", "next.outcome", "next.done", "is_last"
STAMP, LOG_TIME = "stamp", "log_time"
_LARGEST_IMAGE = 8192


class ScanLayout(Schema):
    """Bearings and limits of all scans, as in sensor_msgs/LaserScan."""

    beams: Annotated[int, Field(ge=1, le=MOST_BEAMS)]
    angle_min: Number
    angle_increment: Number
    range_min: Number
    range_max: Number
    frame: Annotated[str, Field(max_length=200)] = ""

    @property
    def geometry(self) -> ScanGeometry:
        """Bearings and limits of the beams."""
        return ScanGeometry(self.beams, self.angle_min, self.angle_increment, self.range_min, self.range_max)


class ImageLayout(Schema):
    """Size of all images [pixels]; three channels in RGB order."""

    height: Annotated[int, Field(ge=1, le=_LARGEST_IMAGE)]
    width: Annotated[int, Field(ge=1, le=_LARGEST_IMAGE)]


class Layout(Schema):
    """Properties shared by all frames of a dataset.

    Attributes:
        format: Version of the layout.
        command: Type of the command messages.
        command_topic: Topic of the command messages.
        scan: Bearings and limits of the scans.
        image: Size of the images; None without a camera.
        goal: Whether goals were recorded.
        reward: Whether rewards were recorded.
        task: Name of the task.
        period: Median time between frames [s].
        digests: Digests stored in the bags: task, policy, value functions.
    """

    format: Literal["frames-1"] = "frames-1"
    command: CommandType
    command_topic: Name
    scan: ScanLayout
    image: ImageLayout | None = None
    goal: bool = False
    reward: bool = False
    task: Name
    period: Positive
    digests: Annotated[dict[str, Annotated[str, Field(max_length=1000)]], Field(max_length=1000, default_factory=dict)]

    @property
    def columns(self) -> dict[str, Column]:
        """Columns of a frame, by name."""
        image = self.image
        columns = {
            SCAN: Column("float32", (self.scan.beams,), "beam"),
            ODOMETRY: Column("float64", (len(ODOMETRY_NAMES),), ODOMETRY_NAMES),
            STATE: Column("float32", (len(STATE_NAMES),), STATE_NAMES),
        }
        if self.goal:
            columns[GOAL] = Column("float64", (len(GOAL_NAMES),), GOAL_NAMES)
        if image is not None:
            columns[IMAGE] = Column("uint8", (image.height, image.width, 3), ("height", "width", "channel"))
        return columns | {
            ACTION: Column("float64", (2,), COMMAND_TYPES[self.command]),
            REWARD: Column("float64"),
            OUTCOME: Column("int64"),
            DONE: Column("bool"),
            IS_LAST: Column("bool"),
            STAMP: Column("int64"),
            LOG_TIME: Column("int64"),
        }

    @property
    def rate(self) -> float:
        """Frames per second, rounded to an integer if close to one."""
        rate = 1.0 / self.period
        return float(round(rate)) if rate >= 1.0 and abs(rate / round(rate) - 1.0) < 0.02 else round(rate, 6)


@dataclass(frozen=True)
class Column:
    """A column of frames: type and shape of a value, and component names."""

    dtype: str
    shape: tuple[int, ...] = ()
    names: tuple[str, ...] | str = ()

    def fits(self, values: NDArray[np.generic]) -> bool:
        """Return whether an array has values of this column, one per row."""
        return values.dtype == np.dtype(self.dtype) and values.shape[1:] == self.shape


@dataclass(frozen=True)
class Frames:
    """Consecutive frames of one episode; each row has a scan, the data known at its time, and the action.

    The last frame of an episode is only an observation: its action repeats the previous one, and its reward is NaN.

    Attributes:
        columns: Arrays by the names of `Layout.columns`, each (n, ...).
        episode: Index of the episode in the dataset.
        source: Index of the bag.
        last: Whether the episode ends with these frames.
    """

    columns: Mapping[str, NDArray[np.generic]]
    episode: int
    source: int
    last: bool

    def __len__(self) -> int:
        return len(self.columns[STAMP])


def whole_episodes(frames: Iterable[Frames]) -> Iterator[tuple[Frames, Mapping[str, NDArray[Any]]]]:
    """Yield each episode's last piece and the columns of all its frames."""
    parts: list[Frames] = []
    for piece in frames:
        parts.append(piece)
        if piece.last:
            yield piece, {name: np.concatenate([part.columns[name] for part in parts]) for name in piece.columns}
            parts = []


def times_of(columns: Mapping[str, NDArray[Any]]) -> NDArray[np.int64]:
    """Return the times of an episode's frames (n,) [ns]: stamps, or log times if stamps do not increase."""
    stamps: NDArray[np.int64] = columns[STAMP]
    return stamps if (np.diff(stamps) > 0).all() else columns[LOG_TIME]


def states_of(odometry: NDArray[np.float64]) -> NDArray[np.float32]:
    """Convert odometry (n, 13) to x, y, theta, v, omega (n, 5), in its own frame and the body frame (REP-103)."""
    x, y, _, q_x, q_y, q_z, q_w, v = odometry.T[:8]
    yaw = np.arctan2(2.0 * (q_w * q_z + q_x * q_y), 1.0 - 2.0 * (q_y * q_y + q_z * q_z))
    return np.stack((x, y, yaw, v, odometry[:, 12]), axis=1).astype(np.float32)


def is_usable(numbers: NDArray[np.float64]) -> bool:
    """Return whether physical quantities are finite and plausible in size."""
    return bool((np.abs(numbers) < 1e30).all())  # false for NaN


_KEY = "ctrl_rl"


def own_info(layout: Layout, sources: Sequence[str]) -> dict[str, Any]:
    """Return the part of a dataset's JSON that `read_own_info` reads; `sources` names the bags."""
    return {_KEY: {"layout": layout.model_dump(), "sources": sources}}


def read_own_info(file: Path) -> Mapping[str, Any]:
    """Read layout and sources from a dataset's JSON file.

    Raises:
        DatasetError: The file has neither.
    """
    content = parse_json(as_text(read_bytes(file, LARGEST_INFO)))
    own = content.get(_KEY) if isinstance(content, dict) else None
    if not isinstance(own, dict):
        raise DatasetError("was not written by `bag export`: it does not describe its frames")
    return own
