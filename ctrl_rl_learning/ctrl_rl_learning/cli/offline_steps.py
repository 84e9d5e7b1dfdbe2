"""Steps that the commands of offline learning share: bags in, a policy out, and a verdict on it.

Torch takes seconds to import: it is imported where it is needed, so that `--help` is quick.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import tyro
from ctrl_rl_bags.datasets import Found, Frames, Layout, TaskDriveOptions, print_note
from ctrl_rl_core.command import FolderToWrite, NotNegative, OptionalNotNegativeNumber, Positive, one_of
from tqdm import tqdm

from ctrl_rl_core import Actor, NavigationTask
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.learners.settings import METHODS, NEEDS_VALUE, LearningSettings
from ctrl_rl_learning.study.curves import Curves

if TYPE_CHECKING:
    from ctrl_rl_learning.offline.data.transitions import Transitions
    from ctrl_rl_learning.offline.data.values import StateValues
    from ctrl_rl_learning.offline.evaluation.verdict import OfflineReport


@dataclass(frozen=True, kw_only=True)
class TaskOptions(TaskDriveOptions):
    """Options of commands that read bags of a task."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN ...]")]
    """Bags, or folders of runs with a bag in `bag`."""
    task: str
    """Task of the bags: one of the suite, or a task file."""
    value: str | None = None
    """Value function: time_to_reach (solved once and kept in --values), oc_value (that ships), or a file."""
    values: FolderToWrite = Path("runs/values")
    """Folder of times to reach."""
    seed: NotNegative = 0
    """Seed of weights, batches and resampling."""
    map_from_bag: bool = False
    """Take the walls from the scans of the bags, not from the task's file."""


@dataclass(frozen=True, kw_only=True)
class TeachOptions(TaskOptions):
    """Options of commands that learn a policy from bags."""

    method: Annotated[str, one_of(METHODS)] = "value_model"
    """Way of learning; by default the commands that the value function calls best are cloned."""
    clearance: OptionalNotNegativeNumber = None
    """Room to obstacles that a time to reach solved here keeps [m]; half the body's radius by default."""
    updates: Positive = 5000
    """Number of updates of the networks."""
    hidden: Positive = 128
    """Units of each of the two hidden layers."""


class Reading(NamedTuple):
    """What a command does with the walls of its task.

    Attributes:
        picture: File of a picture of where bags contradict the task.
        maps: Folder of a map from the bags; None to keep none.
        believes_walls: Whether it goes by the task's walls, as value functions and roll-outs do.
        overwrite: Whether it replaces a map of other walls.
    """

    picture: Path
    maps: Path | None
    believes_walls: bool
    overwrite: bool = False


def read_bags(
    command: str, task: NavigationTask, options: TaskOptions, reading: Reading
) -> tuple[NavigationTask, Transitions]:
    """Return the task and the transitions of its bags; the task is one with the bags' own walls on `--map-from-bag`.

    What the bags hold is printed, and on stderr what was left out or cut, and where they contradict the task.

    Args:
        command: Name of the command, for stderr.
        task: Task that was driven.
        options: Bags, topics and clock.
        reading: What the command does with the walls.

    Raises:
        BagError, LearningError: They cannot be read, hold nothing, or show other walls than those of the task.
    """
    from ctrl_rl_learning.cli.differences import check_differences, take_map
    from ctrl_rl_learning.offline.data.contents import describe
    from ctrl_rl_learning.offline.data.transitions import from_frames, read_frames
    from ctrl_rl_learning.offline.evaluation.verdict import what_few_show
    from ctrl_rl_learning.offline.witness import Witness

    found, witness, note = Found(), Witness(task), partial(print_note, command)
    bags: Iterable[tuple[Layout, Iterable[Frames]]] = read_frames(options.runs, task, options, note, found, witness)
    if options.map_from_bag:
        kept = [(layout, list(frames)) for layout, frames in bags]  # which become transitions among the map's walls
        source, about = options.task, ", ".join(run.name for run in options.runs)
        task = take_map(command, witness.record(), source, about, reading.maps, overwrite=reading.overwrite)
        bags = kept
    transitions = from_frames(bags, task)
    if transitions is None:
        raise LearningError(f"{options.runs[0]}: {found.why_nothing}")
    for line in found.notes:
        note(line)
    for line in describe(transitions, task, found):
        print(line)
    few = what_few_show(transitions.episode_count)
    if few:
        print(f"{command}: {few}", file=sys.stderr)
    if not options.map_from_bag:
        check_differences(command, witness.record(), task, reading.picture, believes_walls=reading.believes_walls)
    return task, transitions


def teach(
    transitions: Transitions,
    task: NavigationTask,
    options: TeachOptions,
    about: Mapping[str, Any] | None = None,
    curves: Curves | None = None,
) -> Actor:
    """Return a policy learnt from transitions, with a progress bar.

    Args:
        transitions: Transitions to learn from.
        task: Task that the policy is for.
        options: Method, value function, updates and seed.
        about: More for the policy's manifest, as JSON.
        curves: Curves that the losses are added to.

    Raises:
        CtrlRlError: The bags or the value function do not suit the method.
    """
    from ctrl_rl_learning.offline.data.values import TIME_TO_REACH, clearance_of, load_values
    from ctrl_rl_learning.offline.learners.learning import learn

    named = options.value or (TIME_TO_REACH if options.method in NEEDS_VALUE else None)
    clearance = clearance_of(task, options.clearance)
    values = None if named is None else load_values(named, task, options.values, clearance)
    settings = LearningSettings(options.method, options.updates, hidden=options.hidden, seed=options.seed)
    told = {"bags": [run.name for run in options.runs], **(about or {})}
    with tqdm(total=settings.updates, desc="learning", unit="update", disable=None) as bar:
        return learn(transitions, task, settings, values, told, bar.update, curves)


def judge(
    transitions: Transitions,
    task: NavigationTask,
    actor: Actor,
    values: StateValues | None,
    *,
    updates: int,
    fits: int,
    seed: int,
) -> OfflineReport:
    """Return what transitions say about a policy, with a progress bar; arguments as of `offline.evaluate_offline`."""
    from ctrl_rl_learning.offline.evaluation.report import evaluate_offline

    with tqdm(total=fits * updates, desc="evaluating", unit="update", disable=None) as bar:
        return evaluate_offline(
            transitions, task, actor, values, updates=updates, fits=fits, seed=seed, tell=bar.update
        )
