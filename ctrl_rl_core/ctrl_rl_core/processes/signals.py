"""Temporary handlers of the signals that end a command."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Signals of a terminal's Ctrl-C and of a supervisor that ends a process."""

Handler = Callable[[int, FrameType | None], object] | signal.Handlers


@contextmanager
def handle_signals(handler: Handler, numbers: Sequence[int] = STOP_SIGNALS) -> Iterator[None]:
    """Handle signals by `handler` within the block. It works in the main thread only."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)
