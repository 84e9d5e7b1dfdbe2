"""Recorded drives and the task that they are of: `transitions` of the front door."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ctrl_rl_bags.datasets import TaskDriveOptions

from ctrl_rl_core import NavigationTask, load_navigation_task
from ctrl_rl_learning.offline.data.transitions import Transitions, load_transitions


@dataclass(frozen=True)
class RecordedDrives:
    """Recorded drives of a task.

    Attributes:
        task: Task that was driven.
        transitions: Observations, actions, rewards and what came of them, those of an episode in order.
        bags: Names of the bags.
    """

    task: NavigationTask
    transitions: Transitions
    bags: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.transitions)


def read_drives(
    bags: Sequence[str | Path] | str | Path, task: NavigationTask | str | Path, robot: str = ""
) -> RecordedDrives:
    """Read bags of a task, each a folder that rosbag2 or the suite's recorder wrote.

    >>> import ctrl_rl, tempfile, pathlib
    >>> from ctrl_rl_learning.offline import ScriptedDriver, drive      # records without ROS
    >>> task = ctrl_rl.load_task("car_navigation")
    >>> bag = pathlib.Path(tempfile.mkdtemp()) / "bag"
    >>> _ = drive(task, ScriptedDriver(task), episodes=2, seed=0, bag=bag)
    >>> data = ctrl_rl.transitions([bag], task)
    >>> data.transitions.episode_count
    2

    Args:
        bags: Bags, or folders of runs with a bag in `bag`.
        task: Task that was driven, its name or its file.
        robot: Namespace of the topics.

    Raises:
        BagError: A bag cannot be read, or lacks scans, odometry or commands.
        LearningError: Nothing in the bags is a transition.
    """
    if not isinstance(task, NavigationTask):
        task = load_navigation_task(task)
    paths = [Path(bag) for bag in ([bags] if isinstance(bags, str | Path) else bags)]
    return RecordedDrives(
        task, load_transitions(paths, task, TaskDriveOptions(robot=robot)), tuple(path.name for path in paths)
    )
