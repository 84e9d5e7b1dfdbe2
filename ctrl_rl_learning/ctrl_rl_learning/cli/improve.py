"""The command `improve`: bags in; a policy, whether it is better than their driver, and what to record next out."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ctrl_rl_bags.datasets import find_bag, find_layout
from ctrl_rl_core.command import FolderToWrite, Positive, checked, finite_number, make_command
from ctrl_rl_core.io import raise_as, read_json, with_digest
from ctrl_rl_core.tasks import require

from ctrl_rl_core import Actor, NavigationTask, atomic_write, load_navigation_task, task_digest, task_names
from ctrl_rl_learning.cli.differences import refusing
from ctrl_rl_learning.cli.offline_steps import Reading, TeachOptions, judge, read_bags, teach
from ctrl_rl_learning.cli.verdict_lines import estimate_lines, verdict_lines
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.learners.settings import METHODS

if TYPE_CHECKING:
    from ctrl_rl_learning.offline.data.transitions import Transitions
    from ctrl_rl_learning.offline.evaluation.verdict import OfflineReport

POLICY, REPORT, PAGE = "policy.safetensors", "report.json", "report.txt"
DIFFERENCES = "differences.png"


def _share(text: str) -> float:
    value = finite_number(text)
    if not 0.0 < value < 1.0:
        raise ValueError(f"'{text}' must be between 0 and 1")
    return value


@dataclass(frozen=True, kw_only=True)
class ImproveOptions(TeachOptions):
    """Make a better policy from bags, and say whether it is: reads, checks, learns, judges, and says what to record.

    Learns from a part of the episodes; the others are held out to judge by. The output folder gets policy.safetensors,
    for `ros2 run ctrl_rl_core policy`, and the report, as text and as JSON. A call that was cut off goes on where it
    was. Exits with 1 where the policy is not shown to be better than the bags' driver, and with 2 where the bags show
    other walls than the task's file.
    """

    task: str = ""
    """Task of the bags: one of the suite, or a task file; by default the one that the bags name."""
    output: FolderToWrite = Path("runs/improved")
    """Folder of policy and report."""
    held_out: Annotated[float, checked(_share, "NUMBER")] = 0.25
    """Share of the episodes that are held out."""
    fit_updates: Positive = 3000
    """Number of updates of each fit that judges."""
    fits: Positive = 3
    """Number of fits, whose spread is part of the intervals."""
    overwrite: bool = False
    """Begin anew where the folder holds a policy of other bags or settings."""


def _improve(options: ImproveOptions) -> int:
    task = load_navigation_task(options.task or _named_task(options))
    require("ctrl_rl_learning improve", task)
    require(f"ctrl_rl_learning learn_offline --method {options.method}", task)
    from ctrl_rl_learning.offline.data.held_out import hold_out

    print(f"task       {task.name}: {task.about}")
    options.output.mkdir(parents=True, exist_ok=True)
    reading = Reading(options.output / DIFFERENCES, options.output, believes_walls=True, overwrite=options.overwrite)
    task, transitions = read_bags("improve", task, replace(options, task=options.task or task.name), reading)
    to_learn, to_judge = hold_out(transitions, options.held_out, options.seed)
    print(f"parts      {to_learn.episode_count} episodes to learn from, {to_judge.episode_count} held out")
    terms = _terms(options, task, to_learn)
    actor = _kept_policy(options, terms)
    if actor is None:
        actor = teach(to_learn, task, options, {"improved": terms})
        actor.save(options.output / POLICY)
    print(f"policy     {options.output / POLICY}: {task.name}, {METHODS[options.method]}")
    terms |= {"fits": options.fits, "fit_updates": options.fit_updates}
    kept = None if options.overwrite else _kept_report(options.output / REPORT, terms)
    if kept is None:
        report = _report(options, task, actor, transitions, to_judge)
        objections = [f"objection  {objection.reason}" for objection in report.objections]
        lines = [*estimate_lines(report), *objections, *verdict_lines(report)]
        kept = {"terms": terms, "verdict": report.verdict, "better": report.better, "lines": lines}
        atomic_write(options.output / REPORT, json.dumps(with_digest(kept)))
    return _tell(options, kept)


def _named_task(options: ImproveOptions) -> str:
    """Return the task of the suite that the first bag names.

    Raises:
        LearningError: It names none.
    """
    bag = find_bag(options.runs[0])
    name = find_layout(bag, options.extraction()).task
    if name not in task_names():
        raise LearningError(f"{bag}: does not say which task of the suite was driven: name it, or its file, by --task")
    return name


def _terms(options: ImproveOptions, task: NavigationTask, to_learn: Transitions) -> dict[str, Any]:
    """Return what must be the same for a call to go on, as JSON."""
    from ctrl_rl_learning.offline.data.digests import episode_digests

    return {
        "task_digest": task_digest(task),
        "episodes": episode_digests(to_learn),
        "method": options.method,
        "updates": options.updates,
        "hidden": options.hidden,
        "seed": options.seed,
        "held_out": options.held_out,
        "value": options.value,
        "clearance": options.clearance,
    }


def _kept_policy(options: ImproveOptions, terms: Mapping[str, Any]) -> Actor | None:
    """Return the policy that an earlier call has learnt; None where there is none.

    Raises:
        LearningError: It was learnt from other bags, or otherwise.
    """
    file = options.output / POLICY
    if not file.exists() or options.overwrite:
        return None
    actor = Actor.load(file)
    before = actor.manifest.get("improved")
    if before != terms:
        known = before if isinstance(before, Mapping) else {}
        other = next(name for name, value in terms.items() if known.get(name) != value)
        raise LearningError(f"{file}: was learnt with other {other}: name another --output, or --overwrite it")
    return actor


def _report(
    options: ImproveOptions, task: NavigationTask, actor: Actor, transitions: Transitions, to_judge: Transitions
) -> OfflineReport:
    """Return what the bags say about a policy, by the held-out episodes where these are enough.

    Where they are few, roll-outs use all episodes: their models are tried on pieces of the bags that they were not
    fitted to. Nothing tries fitted Q evaluation so, and there the held-out episodes alone judge.
    """
    from ctrl_rl_learning.offline.data.held_out import ENOUGH
    from ctrl_rl_learning.offline.data.values import load_values
    from ctrl_rl_learning.offline.evaluation.roll_outs import can_model

    values = None if options.value is None else load_values(options.value, task, options.values)

    def judged(by: Transitions) -> OfflineReport:
        return judge(by, task, actor, values, updates=options.fit_updates, fits=options.fits, seed=options.seed)

    few = to_judge.episode_count < ENOUGH
    if few and can_model(task) and (report := judged(transitions)).by_model:
        return report
    return judged(to_judge)


def _tell(options: ImproveOptions, kept: Mapping[str, Any]) -> int:
    """Print a report, write it as text, and return the exit code."""
    text = "\n".join(kept["lines"])
    atomic_write(options.output / PAGE, f"{text}\n")
    print(text)
    print(f"report     {options.output / PAGE}")
    if kept["verdict"] != "worse":
        print(f"drive it   ros2 run ctrl_rl_core policy --ros-args -p policy:={options.output / POLICY}")
    return 0 if kept["better"] else 1


def _kept_report(file: Path, terms: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the report of an earlier call of the same terms; None where there is none."""
    if not file.exists():
        return None
    with raise_as(LearningError, file, "delete it to have the policy judged again"):
        content: dict[str, Any] = read_json(file)
    return content if content.get("terms") == json.loads(json.dumps(dict(terms))) else None


improve = make_command("improve", ImproveOptions, refusing("improve", _improve))
