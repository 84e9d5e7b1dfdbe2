"""Options shared by the commands on recorded drives, and reading of their segments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from ctrl_rl_bags.datasets import DriveOptions, print_note
from ctrl_rl_core.command import FileToWrite, checked, finite_number
from tqdm import tqdm

from ctrl_rl_core import CommandError
from koopman_lqr_controller.data.trajectory_segments import TrajectorySegment, load_segments
from koopman_lqr_controller.policies.koopman_policy import ObservationFn

TELL = partial(print_note, "note")


@dataclass(frozen=True, kw_only=True)
class PolicyOption:
    """Policy to work on."""

    policy: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    """Policy file of either kind, or the name of a shipped policy."""


@dataclass(frozen=True, kw_only=True)
class TopicOptions(DriveOptions):
    """Topics of the robot in a bag, and the mounting of its lidar."""

    lidar_yaw: Annotated[float | None, checked(finite_number, "FLOAT")] = None
    """Direction of the scan's zero bearing in the robot's frame [rad]; by default from the bag's tf_static, else 0."""


@dataclass(frozen=True, kw_only=True)
class BagOptions(TopicOptions):
    """Bags to work on, and the held-out part."""

    bags: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="BAG [BAG ...]", help_behavior_hint="(required)"),
    ]
    """rosbag2 folders with the topics scan, odom and cmd_vel."""

    held_out: float = 0.2
    """Last fraction of the steps, held out from the fit, in [0, 1)."""

    def __post_init__(self) -> None:
        if not self.bags:
            raise CommandError("missing BAG: give at least one bag")


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Policy file to write."""

    output: FileToWrite
    """Policy file to write (.safetensors)."""

    overwrite: bool = False
    """Replace an existing policy file."""


def read_segments(
    bags: Sequence[Path], options: TopicOptions, observe: ObservationFn, tell: Callable[[str], object] = TELL
) -> list[TrajectorySegment]:
    """Return the segments of all bags, in order.

    Args:
        bags: Folders of rosbag2.
        options: Topics of the robot, and the mounting of its lidar.
        observe: Function from a scan and odometry to an observation.
        tell: Called with lines about omissions; prints them to stderr by default.

    Raises:
        KoopmanError: A topic is missing or has no usable message.
        BagError: A bag cannot be read.
    """
    out: list[TrajectorySegment] = []
    for bag in tqdm(bags, desc="reading", unit="bag", disable=None):
        out += load_segments(bag, observe, options, options.lidar_yaw, tell)
    return out
