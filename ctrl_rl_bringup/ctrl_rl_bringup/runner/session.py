"""rclpy for a command that starts nodes: a signal interrupts it, so that it ends them before itself."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from ctrl_rl_core.processes.children import end_with_ros2
from ctrl_rl_core.processes.signals import handle_signals, interrupt_once
from ctrl_rl_core.ros.running import initialise


@contextmanager
def ros(arguments: list[str] | None = None) -> Iterator[None]:
    """Let rclpy be there; a signal raises KeyboardInterrupt once, those that follow must wait for the end.

    Args:
        arguments: Words of a command line with ROS arguments; those of the process unless given.

    Raises:
        ParameterError: A ROS argument is wrong, or ROS cannot run here.
    """
    end_with_ros2()
    with interrupt_once():
        # rclpy's own handlers would close the context under whoever is waiting in it.
        initialise(sys.argv if arguments is None else arguments)
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
