"""Handlers of the signals that end a process.

Whatever may be caught ends nodes and commands in one way: a terminal that is closed (SIGHUP) leaves a robot standing as
Ctrl-C does.
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

_AGAIN_S = 0.01

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


class Interruption:
    """Whether a signal has come since a block of `interrupt_once` began.

    Attributes:
        came: Whether one has.
    """

    def __init__(self) -> None:
        self.came = False

    def __call__(self, _number: int, _frame: FrameType | None) -> None:
        """Handle a signal."""
        self.came = True
        set_handlers(signal.SIG_IGN)
        raise KeyboardInterrupt

    def raise_lost(self, lost: sys.UnraisableHookArgs) -> None:
        """Interrupt again where Python had nobody to hand the KeyboardInterrupt to, as in a finaliser."""
        if lost.exc_type is not KeyboardInterrupt:
            sys.__unraisablehook__(lost)
            return
        set_handlers(self)
        threading.Timer(_AGAIN_S, os.kill, (os.getpid(), signal.SIGINT)).start()


_interruption: Interruption | None = None


@contextmanager
def interrupt_once() -> Iterator[Interruption]:
    """Let the first signal within the block raise KeyboardInterrupt; those that follow wait for the end.

    A terminal that is closed sends several, and the second must not cut off what the first one began to put in order.
    A block within another is part of that one. Outside of the main thread nothing interrupts.
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
