"""What answers the signals that end a command, for a while."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""What a terminal's Ctrl-C and whoever supervises a process send to end it."""

Handler = Callable[[int, FrameType | None], object] | signal.Handlers


@contextmanager
def handle_signals(handler: Handler, numbers: Sequence[int] = STOP_SIGNALS) -> Iterator[None]:
    """Let `handler` answer these signals within the block. It works in the main thread alone."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)
