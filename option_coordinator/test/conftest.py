"""Fixtures of the tests on real processes: a namespace with coordinators and robots, and the nodes that watch them."""

import pytest
import rclpy
from rig import Rig


@pytest.fixture(scope="module")
def watchers(_no_shared_memory):
    """The tests' nodes: they end together, since the middleware may crash where one ends as its peers are killed."""
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
