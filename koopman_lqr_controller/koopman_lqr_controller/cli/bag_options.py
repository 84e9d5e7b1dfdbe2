"""Options that the commands on recorded drives share, and the segments that they read."""

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
    """Policy that a command works on."""

    policy: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    """Policy file of either kind, or the name of one that comes with the package."""


@dataclass(frozen=True, kw_only=True)
class TopicOptions(DriveOptions):
    """Topics of the robot in a bag, and how its lidar is mounted."""

    lidar_yaw: Annotated[float | None, checked(finite_number, "FLOAT")] = None
    """Direction of the scan's zero bearing in the robot's frame [rad]; by the bag's tf_static unless given, else 0."""


@dataclass(frozen=True, kw_only=True)
class BagOptions(TopicOptions):
    """Bags that a command works on, and the part of them that is held out."""

    bags: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="BAG [BAG ...]", help_behavior_hint="(required)"),
    ]
    """Folders of rosbag2 with the topics scan, odom and cmd_vel."""

    held_out: float = 0.2
    """Last part of the steps, which is kept from the fit; from 0 to below 1."""

    def __post_init__(self) -> None:
        if not self.bags:
            raise CommandError("missing BAG: give one bag at least")


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Policy file that a command writes."""

    output: FileToWrite
    """Policy file to write (.safetensors)."""

    overwrite: bool = False
    """Replace an existing policy file."""


def read_segments(
    bags: Sequence[Path], options: TopicOptions, observe: ObservationFn, tell: Callable[[str], object] = TELL
) -> list[TrajectorySegment]:
    """Return the segments of all bags, in their order.

    Args:
        bags: Folders of rosbag2.
        options: Topics of the robot, and how its lidar is mounted.
        observe: Function from a scan and odometry to an observation.
        tell: Takes lines about what was left out; prints them on stderr unless given.

    Raises:
        KoopmanError: a topic is missing or holds nothing usable.
        BagError: a bag cannot be read.
    """
    out: list[TrajectorySegment] = []
    for bag in tqdm(bags, desc="reading", unit="bag", disable=None):
        out += load_segments(bag, observe, options, options.lidar_yaw, tell)
    return out
