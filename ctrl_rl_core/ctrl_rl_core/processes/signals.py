"""Handlers of the signals that end a process.

All catchable signals end nodes and commands the same way: closing the terminal (SIGHUP) stops a robot just like Ctrl-C.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

_NOT_CAUGHT = {"SIGKILL", "SIGSTOP"}
_CRASHES = {"SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL"}
"""Signals after which the same instruction would fail forever; the process must end at once."""
_SUSPEND = {"SIGTSTP", "SIGTTIN", "SIGTTOU"}
_HARMLESS = {"SIGCHLD", "SIGCLD", "SIGCONT", "SIGURG", "SIGWINCH"}
_ERRORS = {"SIGPIPE", "SIGXFSZ"}
"""Signals that Python ignores; a write fails with an OSError instead."""
_SPARED = _NOT_CAUGHT | _CRASHES | _SUSPEND | _HARMLESS | _ERRORS

STOP_SIGNALS = tuple(sorted(number for number in signal.valid_signals() if getattr(number, "name", "") not in _SPARED))
"""All signals that end a process by default: HUP, INT, QUIT, TERM, USR1, ALRM, the real-time ones ..."""
TERMINAL_SIGNALS = (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP)
r"""Signals that a terminal sends to all processes of a job: Ctrl-C, Ctrl-\, and hang-up."""

_AGAIN_S = 0.01

Handler = Callable[[int, FrameType | None], object] | signal.Handlers


def set_handlers(
    handler: Handler, numbers: Sequence[int] = STOP_SIGNALS
) -> dict[int, Callable[[int, FrameType | None], object] | int | None]:
    """Install `handler` for the stop signals, and return the previous handlers.

    SIGHUP stays ignored under `nohup`, and handlers installed by native library code are kept.
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
    """Handle signals with `handler` within the block; main thread only."""
    before = set_handlers(handler, numbers)
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


class Interruption:
    """Whether a signal has arrived since an `interrupt_once` block started.

    Attributes:
        came: Whether a signal has arrived.
    """

    def __init__(self) -> None:
        self.came = False

    def __call__(self, _number: int, _frame: FrameType | None) -> None:
        """Handle a signal."""
        self.came = True
        set_handlers(signal.SIG_IGN)
        raise KeyboardInterrupt

    def raise_lost(self, lost: sys.UnraisableHookArgs) -> None:
        """Raise again a KeyboardInterrupt that Python could not deliver, as in a finaliser."""
        if lost.exc_type is not KeyboardInterrupt:
            sys.__unraisablehook__(lost)
            return
        set_handlers(self)
        threading.Timer(_AGAIN_S, os.kill, (os.getpid(), signal.SIGINT)).start()


_interruption: Interruption | None = None


@contextmanager
def interrupt_once() -> Iterator[Interruption]:
    """Raise KeyboardInterrupt at the first signal within the block; later signals wait until its end.

    Closing a terminal sends several signals, and the second must not interrupt the clean-up after the first. A nested
    block is part of the outer one. Outside the main thread nothing is interrupted.
    """
    global _interruption
    if _interruption is not None or threading.current_thread() is not threading.main_thread():
        yield _interruption or Interruption()
        return
    _interruption = Interruption()
    hook, sys.unraisablehook = sys.unraisablehook, _interruption.raise_lost
    try:
        with handle_signals(_interruption):
            yield _interruption
    finally:
        _interruption, sys.unraisablehook = None, hook
