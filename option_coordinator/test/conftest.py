"""Fixtures for tests with real processes: a namespace of coordinators and robots, and the nodes that observe them."""

import pytest
import rclpy
from rig import Rig


@pytest.fixture(scope="module")
def watchers(_no_shared_memory):
    """Observer nodes of the tests, shut down together: the middleware may crash if their peers are killed first."""
    rclpy.init()
    nodes = []
    yield nodes
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def rig(tmp_path, watchers):
    out = Rig(tmp_path)
    watchers.append(out.node)
    yield out
    out.close()
