"""Keeps what each robot carries and has delivered, in the robot's own words, outside its process. No ROS, no clock."""

from __future__ import annotations

import sqlite3
from contextlib import suppress
from pathlib import Path

from option_coordinator.errors import OptionError

_BUSY_S = 0.05
"""Maximum wait for another process that writes to the file [s]: robots wait for their grants meanwhile."""
_TABLE = "CREATE TABLE IF NOT EXISTS work (team TEXT, agent TEXT, work TEXT NOT NULL, PRIMARY KEY (team, agent))"


class WorkMemory:
    """The last known work of each robot of a team.

    A change is written before the robot gets its next option, so that a SIGKILL of the coordinator loses none. Several
    coordinators of a team may share a file.

    Args:
        file: SQLite file; in memory only if None.
        team: Name of the team; a file may hold several teams.

    Raises:
        OptionError: The file cannot be opened, or is not an SQLite file.
    """

    def __init__(self, file: Path | None = None, team: str = "") -> None:
        self._team = team
        self._unwritten: set[str] = set()
        try:
            if file is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
            self._base = sqlite3.connect(file or ":memory:", timeout=_BUSY_S, isolation_level=None)
            self._base.execute("PRAGMA journal_mode=WAL")
            self._base.execute("PRAGMA synchronous=NORMAL")  # survives the process; the last change not a power cut
            self._base.execute(_TABLE)
            rows = self._base.execute("SELECT agent, work FROM work WHERE team = ?", (team,)).fetchall()
        except (OSError, sqlite3.Error) as error:
            raise OptionError(f"{file}: the robots' work cannot be kept there: {error}") from error
        self._work: dict[str, str] = dict(rows)

    def of(self, agent: str) -> str:
        """Return the work of a robot; empty if none is known."""
        return self._work.get(agent, "")

    def keep(self, agent: str, work: str) -> bool:
        """Record a robot's work.

        Returns:
            Whether the file holds everything; what it lacks is written with a later call.
        """
        if work != self.of(agent):
            self._work[agent] = work
            self._unwritten.add(agent)
        return not self._unwritten or self._write()

    def forget(self, agent: str) -> bool:
        """Forget the work of a robot whose task is over; return as for `keep`."""
        return self.keep(agent, "")

    def _write(self) -> bool:
        rows = [(self._team, agent, self.of(agent)) for agent in self._unwritten]
        try:
            self._base.execute("BEGIN IMMEDIATE")
            self._base.executemany("INSERT OR REPLACE INTO work VALUES (?, ?, ?)", rows)
            self._base.execute("COMMIT")
        except sqlite3.Error:
            with suppress(sqlite3.Error):
                self._base.execute("ROLLBACK")
            return False
        self._unwritten.clear()
        return True
