"""The command `learn_offline`: a policy from relabelled bags alone."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from ctrl_rl_bags.datasets import TaskDriveOptions, print_note
from ctrl_rl_core.command import (
    FileToWrite,
    FolderToWrite,
    NotNegative,
    OptionalFolderToWrite,
    OptionalNotNegativeNumber,
    Positive,
    make_command,
    one_of,
)
from tqdm import tqdm

from ctrl_rl_core import load_navigation_task
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.learners.settings import METHODS, NEEDS_VALUE, LearningSettings
from ctrl_rl_learning.study.curves import Curves


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


@dataclass(frozen=True, kw_only=True)
class LearnOptions(TaskOptions):
    """Learn a policy from bags alone, for `ros2 run ctrl_rl_core policy`.

    td3bc, iql and cql learn from the rewards that `ros2 run ttr_reward_node relabel` wrote into the bags, and from what
    the task pays at the end of an episode. value_weight, value_model and value_critic need no rewards but a value
    function.
    """

    method: Annotated[str, one_of(METHODS)] = "value_model"
    """Way of learning; by default the commands that the value function calls best are cloned."""
    clearance: OptionalNotNegativeNumber = None
    """Room to obstacles that a time to reach solved here keeps [m]; half the body's radius by default."""
    output: FileToWrite
    """File to write (.safetensors)."""
    updates: Positive = 5000
    """Number of updates of the networks."""
    hidden: Positive = 128
    """Units of each of the two hidden layers."""
    curves: OptionalFolderToWrite = None
    """Folder for the curves of the losses, as CSV and for TensorBoard (default: none are written)."""
    overwrite: bool = False
    """Replace the file if it exists."""


def _learn(options: LearnOptions) -> int:
    if options.output.suffix != ".safetensors":
        raise LearningError(f"{options.output}: the name must end in .safetensors")
    if options.output.exists() and not options.overwrite:
        raise LearningError(f"{options.output} exists: give another name, or --overwrite to replace it")
    task = load_navigation_task(options.task)
    from ctrl_rl_learning.offline.data.transitions import load_transitions
    from ctrl_rl_learning.offline.data.values import TIME_TO_REACH, clearance_of, load_values
    from ctrl_rl_learning.offline.learners.learning import learn

    transitions = load_transitions(options.runs, task, options, tell=partial(print_note, "learn_offline"))
    print(
        f"bags       {transitions.episode_count} episodes, {len(transitions)} steps, success {transitions.success:.0%}"
    )
    named = options.value or (TIME_TO_REACH if options.method in NEEDS_VALUE else None)
    clearance = clearance_of(task, options.clearance)
    values = None if named is None else load_values(named, task, options.values, clearance)
    settings = LearningSettings(options.method, options.updates, hidden=options.hidden, seed=options.seed)
    about = {"bags": [run.name for run in options.runs]}
    with ExitStack() as opened:
        curves = None if options.curves is None else opened.enter_context(Curves(options.curves))
        bar = opened.enter_context(tqdm(total=settings.updates, desc="learning", unit="update", disable=None))
        actor = learn(transitions, task, settings, values, about, bar.update, curves)
    actor.save(options.output)
    print(f"policy     {options.output}: {task.name}, {METHODS[options.method]}")
    print(
        f"judge it   ros2 run ctrl_rl_learning evaluate_offline RUN ... --task {options.task} --policy {options.output}"
    )
    return 0


learn_offline = make_command("learn_offline", LearnOptions, _learn)
