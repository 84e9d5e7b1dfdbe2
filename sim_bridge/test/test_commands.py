import numpy as np
import pytest
from sim_bridge.simulation.commands import CommandChannel

BOUNDS = np.array(((-0.22, 0.22), (-2.84, 2.84)))
IDLE = np.zeros(2)


def test_a_command_is_clipped_and_holds():
    channel = CommandChannel(BOUNDS, IDLE)
    np.testing.assert_array_equal(channel.at(0), IDLE)
    assert channel.send((9.0, -9.0), 1)
    np.testing.assert_array_equal(channel.at(1), (0.22, -2.84))
    np.testing.assert_array_equal(channel.at(100000), (0.22, -2.84))


@pytest.mark.parametrize("command", [(np.nan, 0.0), (0.0, np.inf), (0.1,), (0.1, 0.1, 0.1)])
def test_what_is_not_two_finite_numbers_is_refused(command):
    channel = CommandChannel(BOUNDS, IDLE)
    channel.send((0.1, 0.1), 0)
    assert not channel.send(command, 1)
    np.testing.assert_array_equal(channel.at(2), (0.1, 0.1))


def test_truncation_is_towards_zero():
    channel = CommandChannel(BOUNDS, IDLE, truncation=True)
    channel.send((0.199, -0.999), 0)
    np.testing.assert_allclose(channel.at(0), (0.19, -0.99))
    channel.send((0.0099, -0.0099), 1)
    np.testing.assert_array_equal(channel.at(1), (0.0, 0.0))


def test_delay_and_timeout_count_in_steps():
    channel = CommandChannel(BOUNDS, IDLE, delay=3, timeout=5)
    channel.send((0.1, 0.0), 10)
    channel.send((0.2, 0.0), 11)
    speeds = [channel.at(step)[0] for step in range(10, 21)]
    assert speeds == [0.0, 0.0, 0.0, 0.1, 0.2, 0.2, 0.2, 0.2, 0.2, 0.0, 0.0]
