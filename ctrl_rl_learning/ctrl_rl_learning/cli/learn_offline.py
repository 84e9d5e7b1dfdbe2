"""The command `learn_offline`: learn a policy from relabelled bags alone."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace

from ctrl_rl_core.command import (
    FileToWrite,
    OptionalFolderToWrite,
    make_command,
)
from ctrl_rl_core.tasks import require

from ctrl_rl_core import load_navigation_task
from ctrl_rl_learning.cli.differences import refusing
from ctrl_rl_learning.cli.offline_steps import Reading, TeachOptions, read_bags, teach
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.learners.settings import METHODS, NEEDS_REWARD
from ctrl_rl_learning.study.curves import Curves


@dataclass(frozen=True, kw_only=True)
class LearnOptions(TeachOptions):
    """Learn a policy from bags alone, for `ros2 run ctrl_rl_core policy`.

    td3bc, iql and cql learn from the rewards that `ros2 run ttr_reward_node relabel` wrote into the bags and from the
    task's terminal rewards. value_weight, value_model and value_critic need a value function instead of rewards.
    """

    output: FileToWrite
    """File to write (.safetensors)."""
    curves: OptionalFolderToWrite = None
    """Folder to write the loss curves to, as CSV and for TensorBoard (default: no curves)."""
    overwrite: bool = False
    """Replace the file if it exists."""


def _learn(options: LearnOptions) -> int:
    if options.output.suffix != ".safetensors":
        raise LearningError(f"{options.output}: the name must end in .safetensors")
    if options.output.exists() and not options.overwrite:
        raise LearningError(f"{options.output} exists: give another name, or --overwrite to replace it")
    task = load_navigation_task(options.task)
    require(f"ctrl_rl_learning learn_offline --method {options.method}", task)
    reading = Reading(
        options.output.with_suffix(".differences.png"), options.output.parent, options.method != "bc", options.overwrite
    )
    task, transitions = read_bags("learn_offline", task, options, reading)
    if options.map_from_bag and options.method in NEEDS_REWARD:
        raise LearningError(
            f"the rewards in the bags belong to the task file's walls: relabel the bags for the map's task {task.name} "
            f"and learn with --task {options.output.parent / task.name}.yaml --other-task"
        )
    with ExitStack() as opened:
        curves = None if options.curves is None else opened.enter_context(Curves(options.curves))
        actor = teach(transitions, task, options, curves=curves)
    actor.save(options.output)
    print(f"policy     {options.output}: {task.name}, {METHODS[options.method]}")
    mapped = f"{options.output.parent / task.name}.yaml"
    read_as = replace(options, other_task=options.other_task or options.map_from_bag)
    print(
        "judge it   ros2 run ctrl_rl_learning evaluate_offline RUN ... --task "
        f"{mapped if options.map_from_bag else options.task}{read_as.as_words()} --policy {options.output}"
    )
    return 0


learn_offline = make_command("learn_offline", LearnOptions, refusing("learn_offline", _learn))
