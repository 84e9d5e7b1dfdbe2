"""A signal interrupts a command once, and never in the middle of what cannot be left half done."""

import signal
import time

import pytest
from ctrl_rl_bringup.runner.monitor import Monitor
from ctrl_rl_bringup.runner.processes import ros, uninterrupted
from rclpy.node import Node

from ctrl_rl_core import RESULT
from ctrl_rl_msgs.msg import EpisodeStatus


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_for_the_end_of_the_block(number: int) -> None:
    steps = []
    before = signal.getsignal(number)

    def work() -> None:
        with uninterrupted():
            signal.raise_signal(number)
            steps.append("within")
        steps.append("after")

    with pytest.raises(KeyboardInterrupt), ros():
        work()
    assert steps == ["within"]
    assert signal.getsignal(number) is before


def test_only_the_first_signal_interrupts() -> None:
    with ros():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        with uninterrupted():
            signal.raise_signal(signal.SIGTERM)


def test_a_signal_while_a_message_is_converted_interrupts(monkeypatch: pytest.MonkeyPatch) -> None:
    """rclpy would make `RuntimeError: Unable to convert call argument` of a KeyboardInterrupt there."""
    build = EpisodeStatus.__init__

    def interrupted(self: EpisodeStatus, **fields: object) -> None:
        signal.raise_signal(signal.SIGTERM)
        build(self, **fields)

    def follow() -> None:
        node, monitor, status = Node("simulator"), Monitor(lambda: None), EpisodeStatus()
        publisher = node.create_publisher(EpisodeStatus, "episode", RESULT)
        monkeypatch.setattr(EpisodeStatus, "__init__", interrupted)
        try:
            deadline = time.monotonic() + 120.0
            while time.monotonic() < deadline:
                publisher.publish(status)
                monitor._spin()
        finally:
            monkeypatch.undo()
            monitor.close()
            node.destroy_node()

    with pytest.raises(KeyboardInterrupt), ros():
        follow()
