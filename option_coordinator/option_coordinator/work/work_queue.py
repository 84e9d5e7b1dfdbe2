"""Keeps a team's tasks, their states and their history in an SQLite file. No ROS, no clock.

One table holds everything: each row is a change of a task and has all of the task, so that a task's state is its last
row. Only the flag `last` of a row is ever altered. Each change is on disk before the method returns, whatever happens
to the process or the power.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import astuple, fields, replace
from pathlib import Path
from typing import Any

from option_coordinator.errors import OptionError
from option_coordinator.work.task import OPEN, PRIORITY_S, TRANSITIONS, Change, Task, TaskState

_BUSY_S = 0.2
"""Maximum wait for another process that writes to the file [s]: robots wait for their grants meanwhile."""
MOST_OPEN = 10_000
"""Maximum number of unfinished tasks."""
MOST_ROWS = 1000
"""Maximum number of changes that a method returns."""
_NEAR_S = 600.0
"""Time before the latest time of a task at which it would have been submitted at the latest, for its urgency [s]."""
_TASK = ", ".join(field.name for field in fields(Task))
_COLUMNS = f"number, at, state, robot, reason, base, submitted, {_TASK}"
_TABLE = """
CREATE TABLE IF NOT EXISTS changes (
    number INTEGER PRIMARY KEY AUTOINCREMENT, team TEXT NOT NULL, last INTEGER NOT NULL, at REAL NOT NULL,
    state INTEGER NOT NULL, robot TEXT NOT NULL, reason TEXT NOT NULL, base INTEGER NOT NULL, submitted REAL NOT NULL,
    id TEXT NOT NULL, origin TEXT NOT NULL, destination TEXT NOT NULL, kind TEXT NOT NULL, priority INTEGER NOT NULL,
    earliest REAL NOT NULL, latest REAL NOT NULL, skill TEXT NOT NULL
);
CREATE INDEX IF NOT EXISTS of_task ON changes (team, id, number);
CREATE UNIQUE INDEX IF NOT EXISTS present ON changes (team, id) WHERE last;
CREATE INDEX IF NOT EXISTS by_state ON changes (team, state) WHERE last;
CREATE INDEX IF NOT EXISTS by_robot ON changes (team, robot, number);
"""
_HELD = f"state IN ({int(TaskState.ASSIGNED)}, {int(TaskState.ON_BOARD)})"
_OPEN = f"state IN ({', '.join(str(int(state)) for state in OPEN)})"


class WorkQueue:
    """The tasks of a team.

    Methods that are called again with the same task, state and robot change nothing, so that whoever was interrupted
    may simply repeat. Several processes may share a file.

    Args:
        file: SQLite file.
        team: Name of the team; a file may hold several teams.

    Raises:
        OptionError: Here and in every method: the file cannot be read or written.
    """

    def __init__(self, file: Path, team: str) -> None:
        self._file, self._team = file, team
        with self._told():
            file.parent.mkdir(parents=True, exist_ok=True)
            self._base = sqlite3.connect(file, timeout=_BUSY_S, isolation_level=None)
            self._base.execute("PRAGMA journal_mode=WAL")
            self._base.execute("PRAGMA synchronous=FULL")
            self._base.executescript(_TABLE)

    def close(self) -> None:
        """Close the file."""
        self._base.close()

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Write all changes of a block at once, or none of them if it raises; blocks may be nested."""
        if self._base.in_transaction:
            yield
            return
        with self._told():
            self._base.execute("BEGIN IMMEDIATE")
        try:
            yield
            with self._told():
                self._base.execute("COMMIT")
        except BaseException:
            with suppress(sqlite3.Error):
                self._base.execute("ROLLBACK")
            raise

    def submit(self, task: Task, refusal: str, now: float) -> Change:
        """Record a task as waiting, or as refused; return its state, which is an earlier one if it is known already.

        Args:
            task: The task.
            refusal: Why nobody can do it; empty if somebody can.
            now: Time [s].

        Raises:
            OptionError: Another task has this id, or the queue is full.
        """
        with self.transaction():
            before = self.present(task.id)
            if before is not None and before.state is not TaskState.REFUSED:
                if replace(before.task, priority=0, earliest=0.0, latest=0.0) != replace(
                    task, priority=0, earliest=0.0, latest=0.0
                ):
                    raise OptionError(f"task {task.id!r} exists and is another one: give this one another id")
                return before
            if before is not None and (before.task, before.reason) == (task, refusal):
                return before
            if not refusal and sum(self.unfinished_counts().values()) >= MOST_OPEN:
                raise OptionError(f"task {task.id!r}: the queue is full, {MOST_OPEN} tasks are not finished")
            self._append(Change(0, now, task, TaskState.SUBMITTED, submitted=now))
            state = TaskState.REFUSED if refusal else TaskState.WAITING
            return self._append(Change(0, now, task, state, reason=refusal, submitted=now))

    def adjust(self, task: Task, now: float) -> Change:
        """Give an unfinished task another priority or other times; its state remains.

        Raises:
            OptionError: There is no such task, or it is finished.
        """
        with self.transaction():
            before = self.known(task.id)
            if before.task == task:
                return before
            if before.state not in OPEN:
                raise OptionError(f"task {task.id!r} is {before.state.words}: it cannot be changed")
            return self._append(replace(before, task=task, at=now, reason="changed"))

    def move(
        self, task_id: str, state: TaskState, now: float, robot: str = "", reason: str = "", base: int | None = None
    ) -> Change:
        """Move a task to another state; do nothing if it is in that state already, with that robot.

        Args:
            task_id: Identity of the task.
            state: The next state.
            now: Time [s].
            robot: Robot that has the task; empty for the one that has it, or had it last.
            reason: Why; may be empty.
            base: Deliveries that the robot has made so far, if the task is assigned to it.

        Raises:
            OptionError: There is no such task, or the state cannot follow its state (see `TRANSITIONS`).
        """
        with self.transaction():
            before = self.known(task_id)
            robot = robot or before.robot
            if (before.state, before.robot) == (state, robot):
                return before
            if state not in TRANSITIONS[before.state]:
                raise OptionError(f"task {task_id!r} is {before.state.words}: it cannot be {state.words} next")
            if robot != before.robot and state is not TaskState.ASSIGNED:
                raise OptionError(f"task {task_id!r} is not {robot}'s but {before.robot or 'nobody'}'s")
            if state is TaskState.ASSIGNED and self.held_by(robot) is not None:
                raise OptionError(f"{robot} has a task already: it cannot have {task_id!r}, too")
            base = before.base if base is None else base
            return self._append(replace(before, at=now, state=state, robot=robot, reason=reason, base=base))

    def known(self, task_id: str) -> Change:
        """Return the last change of a task.

        Raises:
            OptionError: There is no such task.
        """
        found = self.present(task_id)
        if found is None:
            raise OptionError(f"there is no task {task_id[:80]!r}")
        return found

    def present(self, task_id: str) -> Change | None:
        """Return the last change of a task; None if there is no such task."""
        return next(iter(self._rows("id = ? AND last", task_id)), None)

    def history(self, task_id: str) -> list[Change]:
        """Return the changes of a task, from the first to the last."""
        return self._rows("id = ? ORDER BY number", task_id)

    def unfinished(self) -> list[Change]:
        """Return the last changes of unfinished tasks, in order of submission."""
        return self._rows(f"last AND {_OPEN} ORDER BY submitted, id")

    def waiting(self, skills: Iterable[str] = ("",), limit: int = MOST_ROWS) -> list[Change]:
        """Return the most urgent waiting tasks.

        Their order is that of submission, a minute earlier for each step of priority; a task whose latest time is near
        counts as submitted ten minutes before it. So none waits for ever.

        Args:
            skills: Skills of which a task may need one; empty for no skill.
            limit: Maximum number of tasks.
        """
        known = sorted(set(skills))
        marks = ", ".join("?" * len(known))
        order = f"MIN(submitted - {PRIORITY_S} * priority, latest - {_NEAR_S}), submitted, id"
        where = f"last AND state = ? AND skill IN ({marks}) ORDER BY {order}"
        return self._rows(where, int(TaskState.WAITING), *known, limit=limit)

    def due(self, before: float) -> list[Change]:
        """Return waiting tasks whose latest time is before a time [s]."""
        return self._rows("last AND state = ? AND latest < ? ORDER BY latest", int(TaskState.WAITING), before)

    def held(self) -> list[Change]:
        """Return the tasks that robots have, assigned or on board."""
        return self._rows(f"last AND {_HELD} ORDER BY submitted, id")

    def held_by(self, robot: str) -> Change | None:
        """Return the task that a robot has; None if it has none."""
        return next(iter(self._rows(f"last AND {_HELD} AND robot = ?", robot)), None)

    def last_of(self, robot: str) -> Change | None:
        """Return the last change of the task that a robot had last; None if it never had one."""
        rows = self._rows("robot = ? ORDER BY number DESC", robot, limit=1)
        return self.present(rows[0].task.id) if rows else None

    def unfinished_counts(self) -> dict[TaskState, int]:
        """Return the number of unfinished tasks in each state."""
        query = f"SELECT state, COUNT(*) FROM changes WHERE team = ? AND last AND {_OPEN} GROUP BY state"
        with self._told():
            return {TaskState(state): count for state, count in self._base.execute(query, (self._team,))}

    def newest(self) -> int:
        """Return the number of the last change of the file; 0 for none."""
        with self._told():
            return int(self._base.execute("SELECT COALESCE(MAX(number), 0) FROM changes").fetchone()[0])

    def since(self, number: int) -> list[Change]:
        """Return the changes after a number, in order; the last ones if there are more than `MOST_ROWS`."""
        return self._rows("number > ? ORDER BY number DESC", number)[::-1]

    def _rows(self, where: str, *values: str | float, limit: int = MOST_ROWS) -> list[Change]:
        query = f"SELECT {_COLUMNS} FROM changes WHERE team = ? AND {where} LIMIT ?"
        with self._told():
            return [_change(row) for row in self._base.execute(query, (self._team, *values, limit))]

    def _append(self, change: Change) -> Change:
        """Append a change within a transaction; return it with its number."""
        row = (self._team, change.at, int(change.state), change.robot, change.reason, change.base, change.submitted)
        marks = ", ".join("?" * (len(row) + len(fields(Task))))
        columns = f"last, team, at, state, robot, reason, base, submitted, {_TASK}"
        with self._told():
            self._base.execute(
                "UPDATE changes SET last = 0 WHERE team = ? AND id = ? AND last", (self._team, change.task.id)
            )
            added = self._base.execute(
                f"INSERT INTO changes ({columns}) VALUES (1, {marks})", (*row, *astuple(change.task))
            )
        return replace(change, number=int(added.lastrowid or 0))

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Raise errors of the file as one line."""
        try:
            yield
        except (OSError, sqlite3.Error) as error:
            raise OptionError(f"{self._file}: tasks cannot be kept there: {error}") from error


def _change(row: tuple[Any, ...]) -> Change:
    number, at, state, robot, reason, base, submitted, *task = row
    return Change(number, at, Task(*task), TaskState(state), robot, reason, base, submitted)
