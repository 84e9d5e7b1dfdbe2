"""rclpy for a command that starts nodes: SIGINT and SIGTERM both interrupt it, so that it ends them before itself."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from ctrl_rl_core.processes.signals import STOP_SIGNALS, handle_signals
from rclpy.signals import SignalHandlerOptions


@contextmanager
def ros() -> Iterator[None]:
    """Let rclpy be there; a signal raises KeyboardInterrupt once, those that follow must wait for the end."""

    def interrupt(_number: int, _frame: object) -> None:
        for number in STOP_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt

    with handle_signals(interrupt):
        # rclpy's own handlers would close the context under whoever is waiting in it.
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        try:
            yield
        finally:
            rclpy.try_shutdown()


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let a signal interrupt after this block, not within it, where it would be lost or leave something half done."""
    caught: list[int] = []
    with handle_signals(lambda number, _frame: caught.append(number)):
        yield
    if caught:
        signal.raise_signal(caught[0])
