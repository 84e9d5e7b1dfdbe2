"""Transitions from bags: a policy's observations, the commands given, rewards, and what came of it.

transitions = load_transitions([Path("runs/drives/bag")], load_navigation_task("car_navigation"))
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from ctrl_rl_bags.alignment import warn
from ctrl_rl_bags.datasets import (
    ACTION,
    DONE,
    IS_LAST,
    OUTCOME,
    REWARD,
    Found,
    Frames,
    Layout,
    TaskDriveOptions,
    TaskView,
    check_task,
    extract,
    find_bag,
    find_layout,
    whole_episodes,
)
from numpy.typing import NDArray

from ctrl_rl_core import (
    NavigationTask,
    PolicyManifest,
    interface_of,
    load_navigation_task,
    task_digest,
)
from ctrl_rl_learning.errors import LearningError

if TYPE_CHECKING:
    from ctrl_rl_learning.offline.witness.record import Witness


def sensed_interface(task: NavigationTask) -> PolicyManifest:
    """Return the interface of a task's policies, without the pose in a corridor.

    Nothing in a corridor tells a robot where it is on the map: a bag's poses are for the value function alone, and the
    policy drives by its scans and speeds.
    """
    interface = interface_of(task)
    if task.corridor is None:
        return interface
    sensed = [part for part in interface.observation if part.source != "pose"]
    return interface.model_copy(update={"observation": sensed})


Array = NDArray[np.float64]
Vectors = NDArray[np.float32]


@dataclass(frozen=True)
class Transitions:
    """Transitions of recorded drives, those of an episode in order.

    Attributes:
        observations: Observations before (N, n), in SI units.
        actions: Actions in [-1, 1] (N, 2), which map to the least and the largest command.
        rewards: Rewards (N,): of the bag, and of the task where an episode ended; NaN where the bag has none.
        task_rewards: Rewards of the task alone (N,): 0 but where an episode ended.
        next_observations: Observations after (N, n).
        done: Whether the episode ended there, other than by its time (N,).
        states: States before (N, d), in SI units.
        next_states: States after (N, d).
        episodes: Number of the episode (N,), rising.
        outcomes: Outcome after (N,), as in ctrl_rl_core.Outcome.
        first: Whether the transition begins its episode (N,).
    """

    observations: Vectors
    actions: Vectors
    rewards: Array
    task_rewards: Array
    next_observations: Vectors
    done: NDArray[np.bool_]
    states: Array
    next_states: Array
    episodes: NDArray[np.int64]
    outcomes: NDArray[np.int64]
    first: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.actions)

    @property
    def success(self) -> float:
        """Share of the episodes that reached the goal."""
        ends = np.append(np.flatnonzero(self.first)[1:] - 1, len(self) - 1)
        return float(np.mean(self.outcomes[ends] == 1))

    @property
    def episode_count(self) -> int:
        """Number of episodes."""
        return int(self.first.sum())

    def returns(self, discount: float) -> Array:
        """Return the discounted return of each episode (episodes,), by the task's rewards."""
        starts = np.flatnonzero(self.first)
        steps = np.arange(len(self)) - starts[np.cumsum(self.first) - 1]
        return np.add.reduceat(self.task_rewards * discount**steps, starts)

    def rows(self, index: NDArray[Any]) -> Transitions:
        """Return some transitions."""
        return Transitions(**{field.name: getattr(self, field.name)[index] for field in fields(self)})


def load_transitions(
    runs: Sequence[Path],
    task: NavigationTask,
    options: TaskDriveOptions | None = None,
    interface: PolicyManifest | None = None,
    tell: Callable[[str], object] = warn,
    found: Found | None = None,
    witness: Witness | None = None,
) -> Transitions:
    """Return the transitions of bags, in steps of the task's length.

    Args:
        runs: Bags, or folders of runs with a bag in `bag`.
        task: Task that was driven.
        options: Topics, beams and clock of the bags; the usual ones unless given.
        interface: Observation and commands of the policies; None for `sensed_interface`.
        tell: Takes a line about what was left out; warns unless given.
        found: Receives delays, intervals and what was missing; a new one unless given.
        witness: Receives scans and poses, for `ctrl_rl_learning.offline.witness.examine`.

    Raises:
        BagError: A bag cannot be read or lacks scans, odometry or commands; it is of another task, or its scans come
            more seldom than the task's steps.
        LearningError: Nothing in it is a transition.
        PolicyError: The scans do not show what a policy observes.
    """
    found = Found() if found is None else found
    bags = read_frames(runs, task, options or TaskDriveOptions(), tell, found, witness)
    transitions = from_frames(bags, task, interface)
    if transitions is None:
        raise LearningError(f"{runs[0]}: {found.why_nothing}")
    for line in found.notes:
        tell(line)
    return transitions


def read_frames(
    runs: Sequence[Path],
    task: NavigationTask,
    options: TaskDriveOptions,
    tell: Callable[[str], object],
    found: Found,
    witness: Witness | None = None,
) -> Iterator[tuple[Layout, Iterable[Frames]]]:
    """Yield layout and frames of each bag; arguments and errors as of `load_transitions`."""
    how = options.extraction(period=task.episode.time_step)
    for run in runs:
        bag = find_bag(run)
        layout = find_layout(bag, how)
        check_task(bag, layout.digests, task.name, task_digest(task), allowed=options.other_task, tell=tell)
        frames = extract([bag], layout, how, found)
        yield layout, frames if witness is None else witness.watch(frames, layout.scan)


def from_frames(
    bags: Iterable[tuple[Layout, Iterable[Frames]]], task: NavigationTask, interface: PolicyManifest | None = None
) -> Transitions | None:
    """Return the transitions of bags by layout and frames; None where there are none."""
    parts: list[Transitions] = []
    for layout, frames in bags:
        before = 0 if not parts else int(parts[-1].episodes[-1]) + 1
        parts += to_transitions(frames, layout, task, before, interface)
    return concatenate(parts) if parts else None


def to_transitions(
    frames: Iterable[Frames],
    layout: Layout,
    task: NavigationTask,
    before: int = 0,
    interface: PolicyManifest | None = None,
) -> list[Transitions]:
    """Return the transitions of each episode of frames; their numbers count from `before`."""
    view = TaskView(task, layout, interface or sensed_interface(task))
    return [_episode(columns, view, before + piece.episode) for piece, columns in whole_episodes(frames)]


def concatenate(parts: Sequence[Transitions]) -> Transitions:
    """Return all transitions of several sets, in their order."""
    names = [field.name for field in fields(Transitions)]
    return Transitions(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def _episode(columns: Mapping[str, NDArray[Any]], view: TaskView, number: int) -> Transitions:
    seen, states = view.observe(columns)
    kept = ~columns[IS_LAST].astype(np.bool_)
    outcomes = columns[OUTCOME][kept].astype(np.int64)
    paid = view.paid(outcomes)
    first = np.zeros(len(outcomes), dtype=np.bool_)
    first[0] = True
    return Transitions(
        observations=seen[:-1],
        actions=view.actions(columns[ACTION][kept]),
        rewards=np.where(outcomes == 0, columns[REWARD][kept], paid),
        task_rewards=paid,
        next_observations=seen[1:],
        done=columns[DONE][kept].astype(np.bool_),
        states=states[:-1],
        next_states=states[1:],
        episodes=np.full(len(outcomes), number, dtype=np.int64),
        outcomes=outcomes,
        first=first,
    )


@dataclass(frozen=True)
class RecordedDrives:
    """Recorded drives of a task.

    Attributes:
        task: Task of the drives.
        transitions: Observations, actions, rewards and next observations, in order within each episode.
        bags: Names of the bags.
        refusal: Reason why value functions do not apply, i.e. walls that differ from the task's; empty if they apply.
    """

    task: NavigationTask
    transitions: Transitions
    bags: tuple[str, ...]
    refusal: str = ""

    def __len__(self) -> int:
        return len(self.transitions)


def read_drives(
    bags: Sequence[str | Path] | str | Path, task: NavigationTask | str | Path, robot: str = ""
) -> RecordedDrives:
    """Read bags of a task, each a folder that rosbag2 or the suite's recorder wrote; warn where they contradict it.

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
    from ctrl_rl_learning.offline.witness import Witness, examine  # which knows transitions

    witness = Witness(task)
    transitions = load_transitions(paths, task, TaskDriveOptions(robot=robot), witness=witness)
    account = examine(witness.record(), task)
    for line in account.lines:
        warn(line)
    return RecordedDrives(task, transitions, tuple(path.name for path in paths), account.refusal)
