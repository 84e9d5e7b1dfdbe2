"""Work in a thread, where only the latest request counts."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

_Result = TypeVar("_Result")


@dataclass
class Job(Generic[_Result]):
    """A piece of work.

    Attributes:
        result: Result of the work; None while it runs, and after an error.
        error: Error that the work raised.
        done: Completed fraction, 0 to 1.
        wanted: Whether the result is still needed.
        finished: Set when a result or an error is available.
    """

    result: _Result | None = None
    error: Exception | None = None
    done: float = 0.0
    wanted: bool = True
    finished: threading.Event = field(default_factory=threading.Event)

    def cancel(self) -> None:
        """Mark the result as no longer needed."""
        self.wanted = False

    def run(self, work: Callable[[Job[_Result]], _Result]) -> None:
        """Do the work in this thread."""
        try:
            self.result = work(self)
        except Exception as error:  # passed on to the requester
            self.error = error
        finally:
            self.finished.set()


def start_job(work: Callable[[Job[_Result]], _Result], inline: bool = False) -> Job[_Result]:
    """Start work in a thread, or do it at once; `work` receives its job to report progress and check `wanted`."""
    job: Job[_Result] = Job()
    if inline:
        job.run(work)
    else:
        threading.Thread(target=job.run, args=(work,), daemon=True).start()
    return job
