"""What a signal asks of a node process: to end, to be suspended, to interrupt long work."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager


class InterruptedWorkError(BaseException):
    """A signal arrived during interruptible work."""


class StopRequest:
    """Handles the signals that end a process: they request shutdown, and interrupt blocks that allow it.

    Attributes:
        asked: Whether shutdown was requested.
        suspended: Whether Ctrl-Z is pending.
    """

    def __init__(self) -> None:
        self.asked = self.suspended = False
        self._may_raise = False

    def suspend(self, _signal: int, _frame: object) -> None:
        """Record Ctrl-Z."""
        self.suspended = True

    def __call__(self, _signal: int, _frame: object) -> None:
        """Record the request to end, and interrupt a block that allows it."""
        self.asked = True
        if self._may_raise:
            self._may_raise = False
            raise InterruptedWorkError

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Let a signal interrupt this block; in another thread than the main one, where no signal arrives, it waits."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        if self.asked:
            raise InterruptedWorkError
        before, self._may_raise = self._may_raise, True
        try:
            yield
        finally:
            self._may_raise = before


stop_request = StopRequest()
"""The request of this process."""
interruptible = stop_request.at_once
"""Context for long work in a callback, such as reading a file: a signal may abort it anywhere and end the node."""
