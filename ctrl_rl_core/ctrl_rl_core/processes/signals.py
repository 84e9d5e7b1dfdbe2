"""Handlers of the signals that end a process.

Whatever may be caught ends nodes and commands in one way: a terminal that is closed (SIGHUP) leaves a robot standing as
Ctrl-C does.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

_NOT_CAUGHT = {"SIGKILL", "SIGSTOP"}
_CRASHES = {"SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL"}
"""After these the same instruction would fail again, for ever: the process must end at once."""
_SUSPEND = {"SIGTSTP", "SIGTTIN", "SIGTTOU"}
_HARMLESS = {"SIGCHLD", "SIGCLD", "SIGCONT", "SIGURG", "SIGWINCH"}
_ERRORS = {"SIGPIPE", "SIGXFSZ"}
"""Python ignores these: a write fails with an OSError instead."""
_SPARED = _NOT_CAUGHT | _CRASHES | _SUSPEND | _HARMLESS | _ERRORS

STOP_SIGNALS = tuple(sorted(number for number in signal.valid_signals() if getattr(number, "name", "") not in _SPARED))
"""All signals that end a process unless it catches them: HUP, INT, QUIT, TERM, USR1, ALRM, the real-time ones ..."""
TERMINAL_SIGNALS = (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP)
"""Signals that a terminal sends to all processes of a job at once: Ctrl-C, Ctrl-\\, and its own end."""

Handler = Callable[[int, FrameType | None], object] | signal.Handlers


def set_handlers(
    handler: Handler, numbers: Sequence[int] = STOP_SIGNALS
) -> dict[int, Callable[[int, FrameType | None], object] | int | None]:
    """Handle signals by `handler` from now on, and return the handlers of before.

    SIGHUP stays ignored where `nohup` lets it be, and a handler that a library's own code has set stays.
    """
    before = {}
    for number in numbers:
        former = signal.getsignal(number)
        nohup = number == signal.SIGHUP and former is signal.SIG_IGN
        if former is not None and not nohup:
            before[number] = signal.signal(number, handler)
    return before


@contextmanager
def handle_signals(handler: Handler, numbers: Sequence[int] = STOP_SIGNALS) -> Iterator[None]:
    """Handle signals by `handler` within the block. It works in the main thread only."""
    before = set_handlers(handler, numbers)
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


@contextmanager
def interrupt_once() -> Iterator[None]:
    """Let the first signal within the block raise KeyboardInterrupt; those that follow wait for the end.

    A terminal that is closed sends several, and the second must not cut off what the first one began to put in order.
    """

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        set_handlers(signal.SIG_IGN)
        raise KeyboardInterrupt

    with handle_signals(interrupt):
        yield
