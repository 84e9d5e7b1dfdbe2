"""Check bags against their task file before a command learns or evaluates, and report the differences."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

from ctrl_rl_core.command import EXIT_USAGE

from ctrl_rl_core import NavigationTask, load_navigation_task, task_digest
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.witness import DriveRecord, draw_account, examine, map_from_record, task_with_map

_Options = TypeVar("_Options")


class ContradictedError(LearningError):
    """Bags contradict their task's walls, so neither value functions nor roll-outs are valid."""


def refusing(command: str, work: Callable[[_Options], int]) -> Callable[[_Options], int]:
    """Wrap a command so that it prints one line and exits with code 2 if the bags contradict their task."""

    def guarded(options: _Options) -> int:
        try:
            return work(options)
        except ContradictedError as error:
            print(f"{command}: {error}", file=sys.stderr)
            return EXIT_USAGE

    return guarded


def check_differences(
    command: str, record: DriveRecord, task: NavigationTask, picture: Path, *, believes_walls: bool
) -> None:
    """Print each difference between bags and task file on stderr, and draw a picture if any is serious.

    Args:
        command: Name of the command.
        record: Recorded drives.
        task: Task of the bags.
        picture: File to draw the picture to.
        believes_walls: Whether the command relies on the task's walls, as value functions and roll-outs do.

    Raises:
        ContradictedError: The command relies on the task's walls, and the bags show different ones.
    """
    account = examine(record, task)
    for line in account.lines:
        print(f"{command}: {line}", file=sys.stderr)
    if not account.refusal:
        return
    draw_account(account, picture)
    print(f"picture    {picture}: the file's walls, the beams that contradict them, and the drives")
    if believes_walls:
        raise ContradictedError(account.refusal)


def take_map(
    command: str, record: DriveRecord, source: str, about: str, folder: Path | None, *, overwrite: bool = False
) -> NavigationTask:
    """Return the task with its walls replaced by those that the scans in the bags show.

    Args:
        command: Name of the command.
        record: Recorded drives.
        source: Name or file of the recorded task.
        about: Names of the bags.
        folder: Folder to write task file and map to; None to write neither.
        overwrite: Whether to replace a map with different walls.

    Raises:
        LearningError: The task has no walls that a map could replace, or the folder holds a map with different walls.
    """
    task = load_navigation_task(source)
    mapped = map_from_record(record, task)
    with TemporaryDirectory() as temporary:
        found = load_navigation_task(task_with_map(mapped, task, source, Path(temporary), about))
    if folder is not None:
        file = folder / f"{found.name}.yaml"
        if file.exists() and not overwrite and task_digest(load_navigation_task(file)) != task_digest(found):
            raise LearningError(
                f"{file} exists with different walls: name another folder, or replace it by --overwrite"
            )
        found = load_navigation_task(task_with_map(mapped, task, source, folder, about))
        print(f"map        {file}: walls from the bags; pass --task {file} --other-task to other commands")
    account = examine(record, found)
    print(f"           {account.differing:.1%} of the beams differ from it")
    for place in account.moved_walls:
        print(f"{command}: the map lacks {place}", file=sys.stderr)
    return found
