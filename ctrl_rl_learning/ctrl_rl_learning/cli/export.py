"""The command `export`: write a run's policy, with a description of its observation, for the node `policy`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro
from ctrl_rl_core.command import FileToWrite
from ctrl_rl_core.io import raise_as, read_json

from ctrl_rl_core import Actor, interface_of, task_digest
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.study.command import find_learnt_task, make_command


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """Write a run's policy for `ros2 run ctrl_rl_core policy`, with its interface, task and success rate."""

    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Folder of a finished `train` run, or a policy file."""
    output: FileToWrite
    """File to write (.safetensors)."""
    task: str | None = None
    """Task of the suite, or a task file (default: the task that the policy was trained on)."""
    overwrite: bool = False
    """Replace the file if it exists."""


def _export(options: ExportOptions) -> int:
    source = options.run / "policy.safetensors" if options.run.is_dir() else options.run
    if options.output.suffix != ".safetensors":
        raise LearningError(f"{options.output}: the name must end in .safetensors")
    if options.output.exists() and not options.overwrite:
        raise LearningError(f"{options.output} exists: give another name, or --overwrite to replace it")
    actor = Actor.load(source)
    task = find_learnt_task(source, str(actor.manifest.get("task")), options.task, LearningError)
    if actor.manifest.get("task_digest", task_digest(task)) != task_digest(task):
        raise LearningError(f"{source}: was trained on another task or another version of it: give its file by --task")
    manifest = {**actor.manifest, "task": task.name, "task_digest": task_digest(task)}
    if "metrics" not in manifest and options.run.is_dir():
        manifest["metrics"] = _metrics(options.run / "result.json")
    exported = replace(actor, manifest=manifest, interface=interface_of(task))
    with raise_as(LearningError, source, "it does not fit the task"):
        exported.check()
    exported.save(options.output)
    success = (manifest.get("metrics") or {}).get("success")
    told = "" if success is None else f", success {success:.0%} in its environment"
    print(f"policy     {options.output}: {task.name}{told}")
    print(f"try it     ros2 run ctrl_rl_core policy --ros-args -p policy:={options.output}")
    return 0


def _metrics(result: Path) -> dict[str, float]:
    """Return the success rate of a run, or an empty dictionary if the run was not evaluated."""
    with raise_as(LearningError, result, "let `train` finish the run"):
        content = read_json(result)
    success = content.get("success") if isinstance(content, dict) else None
    return {"success": float(success)} if isinstance(success, int | float) else {}


export = make_command("export", ExportOptions, _export)
