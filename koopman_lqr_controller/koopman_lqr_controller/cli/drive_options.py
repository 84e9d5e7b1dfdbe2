"""What the commands share that make policies from recorded drives, or judge them by these."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from ctrl_rl_core.command import file_to_write
from tqdm import tqdm

from koopman_lqr_controller.data.trajectory_segments import TrajectorySegment, load_segments
from koopman_lqr_controller.policies.koopman_policy import ObservationFn


def add_drives(parser: argparse.ArgumentParser) -> None:
    """Give a command the bags that it works on, and the part of them that is held out."""
    parser.add_argument("bags", nargs="+", type=Path, help="rosbag2 folders with scan, odom and cmd_vel")
    add_topics(parser)
    parser.add_argument(
        "--held-out", type=float, default=0.2, help="last part of the steps, kept from the fit (default %(default)s)"
    )


def add_topics(parser: argparse.ArgumentParser) -> None:
    """Give a command what says which topics of a bag are the robot's, and how its lidar is mounted."""
    parser.add_argument("--robot", default="", help="namespace of the topics in the bags (default: none)")
    parser.add_argument(
        "--lidar-yaw", type=_yaw, help="of the scan's zero bearing [rad] (default: as the bag's tf_static says, or 0)"
    )


def add_output(parser: argparse.ArgumentParser) -> None:
    """Give a command the policy file that it writes."""
    parser.add_argument("--output", type=file_to_write, required=True, help="policy file to write (.safetensors)")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing policy file")


def read_segments(options: argparse.Namespace, observe: ObservationFn) -> list[TrajectorySegment]:
    """Return what is seen and commanded in the bags that were given, see `load_segments`.

    Raises:
        KoopmanError: a topic is missing or holds nothing usable.
        BagError: a bag cannot be read.
    """
    out: list[TrajectorySegment] = []
    for bag in tqdm(options.bags, desc="reading", unit="bag", disable=None):
        out += load_segments(bag, observe, options.robot, options.lidar_yaw)
    return out


def _yaw(text: str) -> float:
    yaw = float(text)
    if not math.isfinite(yaw):
        raise argparse.ArgumentTypeError(f"{text} is no direction")
    return yaw
