"""Options that all commands share which read drives from bags: topics, beams and clock."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

from ctrl_rl_core.command import at_least, one_of

from ctrl_rl_bags.alignment.clocks import Clock, Tell, warn
from ctrl_rl_bags.datasets.wiring import ExtractionOptions
from ctrl_rl_bags.format.checks import BagError

TASK_DIGEST = "digest.task"
"""Key of a bag's custom data under which the recorder keeps the digest of the task that was driven."""
_SHOWN = 12


@dataclass(frozen=True, kw_only=True)
class DriveOptions:
    """Topics of a drive in a bag, beams of its scans, and the clock of its messages."""

    robot: str = ""
    """Namespace of the topics in the bags; none unless given."""
    scan: str = "scan"
    """Topic of the scans, in the namespace unless it begins with /."""
    odometry: str = "odom"
    """Topic of the odometry."""
    commands: str = ""
    """Topic of the commands (default: cmd_vel, or else rotor_thrusts)."""
    beams: at_least(1) | None = None  # type: ignore[valid-type]
    """Number of beams that all scans are brought to (default: that of the first scan)."""
    clock: Annotated[Clock, one_of(get_args(Clock))] = "header"
    """Time of messages: their stamps, or log, the times at which they were received."""

    def extraction(self, **more: Any) -> ExtractionOptions:
        """Return these options for `extract`, and more of its own."""
        return ExtractionOptions(
            robot=self.robot,
            scan=self.scan,
            odometry=self.odometry,
            commands=self.commands,
            beams=self.beams,
            clock=self.clock,
            **more,
        )


@dataclass(frozen=True, kw_only=True)
class TaskDriveOptions(DriveOptions):
    """The same, of a task's drives."""

    other_task: bool = False
    """Take bags of another task, or of another version of it, too."""


def check_task(
    bag: Path | str, custom_data: Mapping[str, str], task: str, digest: str, *, allowed: bool, tell: Tell = warn
) -> None:
    """Refuse a bag in which another task was driven; one that names none is taken.

    Args:
        bag: Bag whose task is compared.
        custom_data: Its custom data.
        task: Name of the task that is learnt.
        digest: Digest of that task.
        allowed: Whether a line takes the place of the refusal.
        tell: Takes that line; warns unless given.

    Raises:
        BagError: The digests differ.
    """
    there = custom_data.get(TASK_DIGEST, "")
    if not there or there == digest:
        return
    line = (
        f"{bag}: was recorded in another task than '{task}', or in another version of it "
        f"({TASK_DIGEST} {there[:_SHOWN]}, not {digest[:_SHOWN]})"
    )
    if not allowed:
        raise BagError(f"{line}: name that task, or take the bag with --other-task")
    tell(line)


def print_note(command: str, line: str) -> None:
    """Print what was left out of bags on stderr."""
    sys.stderr.write(f"{command}: {line}\n")
