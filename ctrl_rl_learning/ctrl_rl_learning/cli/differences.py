"""What commands say and do where bags contradict the file of their task, before anything is learnt or judged."""

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
    """Bags show that nothing may be learnt by value or judged by roll-outs in their task."""


def refusing(command: str, work: Callable[[_Options], int]) -> Callable[[_Options], int]:
    """Return a command's work with exit code 2 and one line where bags contradict their task."""

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
    """Print each difference between bags and their task's file on stderr, with a picture where they are grave.

    Args:
        command: Name of the command.
        record: What the drives saw and did.
        task: Task of the bags.
        picture: File of the picture.
        believes_walls: Whether the command goes by the task's walls, as value functions and roll-outs do.

    Raises:
        ContradictedError: It does, and they are others.
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
    """Return a task with the walls that bags show in place of its own.

    Args:
        command: Name of the command.
        record: What the drives saw.
        source: Name or file of the task that was driven.
        about: Names of the bags.
        folder: Folder of the task's file and its map; None to keep neither.
        overwrite: Whether to replace those of other walls.

    Raises:
        LearningError: The task has no walls that a map could replace, or the folder holds a map of other walls.
    """
    task = load_navigation_task(source)
    mapped = map_from_record(record, task)
    with TemporaryDirectory() as temporary:
        found = load_navigation_task(task_with_map(mapped, task, source, Path(temporary), about))
    if folder is not None:
        file = folder / f"{found.name}.yaml"
        if file.exists() and not overwrite and task_digest(load_navigation_task(file)) != task_digest(found):
            raise LearningError(f"{file} exists, with other walls: name another folder, or --overwrite to replace it")
        found = load_navigation_task(task_with_map(mapped, task, source, folder, about))
        print(f"map        {file}: the walls by the bags; for other commands --task {file} --other-task")
    account = examine(record, found)
    print(f"           {account.differing:.1%} of the beams differ from it")
    for place in account.moved_walls:
        print(f"{command}: the map lacks {place}", file=sys.stderr)
    return found
