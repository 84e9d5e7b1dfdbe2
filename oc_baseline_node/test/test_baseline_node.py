"""The baseline node as a process: one value per odometry message, queries, a clean shutdown."""

import signal
import time
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
from ctrl_rl_core.ros import LATCHED, answer
from ctrl_rl_core.values import ROWS, Axis
from nav_msgs.msg import OccupancyGrid, Odometry
from oc_baseline_node.node import OcBaselineNode
from oc_baseline_node.values.collision_set import CollisionSet
from oc_baseline_node.values.value_file import load_network
from rclpy.node import Node

from ctrl_rl_core import RESULT, Box
from ctrl_rl_msgs.msg import StateValue
from ctrl_rl_msgs.msg import ValueGrid as ValueGridMsg
from ctrl_rl_msgs.srv import QueryValues
from oc_baseline_node import MlpValue, save_value, shipped_values

OTHER_VERSION = "was made for another version of task 'car_navigation'"


def small_value() -> MlpValue:
    """Return 100 tanh(x / 5) + 500 over the plane, with a wall."""
    axes = (
        Axis("x", "m", -5.0, 5.0, 21),
        Axis("y", "m", -5.0, 5.0, 21),
        Axis("theta", "rad", -np.pi, np.pi, 8, periodic=True),
    )
    layers = ((np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros(1)), (np.ones((1, 1)), np.zeros(1)))
    wall = CollisionSet((Box((0.0, 4.0), (1.0, 1.0)),), 0.2, -400.0, np.inf, -400.0)
    return MlpValue(layers, axes, 500.0, 100.0, "car_navigation", "0" * 64, wall)


class Listener:
    """Counterpart of the node: publishes odometry, records values and sends queries."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = Node("listener")
        self.odom = self.node.create_publisher(Odometry, "odom", 10)
        self.values: list[StateValue] = []
        self.grids: list[ValueGridMsg] = []
        self.slices: list[OccupancyGrid] = []
        self.node.create_subscription(StateValue, "oc_value", self.values.append, RESULT)
        self.node.create_subscription(ValueGridMsg, "oc_baseline_node/grid", self.grids.append, LATCHED)
        self.node.create_subscription(OccupancyGrid, "oc_baseline_node/slice", self.slices.append, LATCHED)
        self.query = self.node.create_client(QueryValues, "oc_baseline_node/query")

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown()

    def until(self, done: Callable[[], bool], seconds: float = 120.0) -> None:
        deadline = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < deadline
            rclpy.spin_once(self.node, timeout_sec=0.02)

    def at(self, x: float, y: float) -> StateValue:
        """Return the node's value at a pose."""
        count = len(self.values)
        message = Odometry()
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation.w = 1.0
        self.odom.publish(message)
        self.until(lambda: len(self.values) > count)
        return self.values[-1]


@pytest.fixture
def listener() -> Iterator[Listener]:
    listener = Listener()
    yield listener
    listener.close()


def test_it_serves_values_grid_slice_and_queries(listener: Listener, run_node: Callable, tmp_path: Path) -> None:
    path, value = tmp_path / "v.safetensors", small_value()
    save_value(value, path)
    node = run_node("oc_baseline_node", "baseline", f"grid:={path}")
    node.wait_for(OTHER_VERSION)
    node.wait_for("task 'car_navigation'")
    listener.until(lambda: listener.odom.get_subscription_count() > 0 and len(listener.grids) > 0)
    listener.until(lambda: listener.node.count_publishers("oc_value") > 0 and len(listener.slices) > 0)
    time.sleep(0.3)
    inside = listener.at(1.0, -2.0)
    assert inside.in_domain
    assert inside.value == pytest.approx(float(value.value((1.0, -2.0, 0.0))), rel=1e-6)
    assert list(inside.state) == pytest.approx([1.0, -2.0, 0.0])
    assert inside.gradient[0] == pytest.approx(20.0 / np.cosh(0.2) ** 2, rel=1e-5)
    assert listener.at(0.0, 4.0).value == -400.0
    outside = listener.at(9.0, 0.0)
    assert not outside.in_domain
    assert np.isnan(outside.value)
    grid = listener.grids[-1]
    assert (grid.kind, grid.task, len(grid.values)) == ("oc_value", "car_navigation", 21 * 21 * 8)
    assert np.asarray(grid.values)[-1] == pytest.approx(500 + 100 * np.tanh(1.0), rel=1e-5)
    assert max(listener.slices[-1].data) == 100
    assert listener.query.wait_for_service(10.0)
    answer = listener.query.call_async(QueryValues.Request(states=[1.0, -2.0, 0.0, 9.0, 0.0, 0.0]))
    listener.until(answer.done)
    assert answer.result().success
    assert list(answer.result().in_domain) == [True, False]
    assert answer.result().values[0] == pytest.approx(inside.value)
    code, _ = node.stop(signal.SIGINT)
    assert code == 0, node.output
    assert "Traceback" not in node.output


def test_a_large_query_takes_hardly_more_memory_than_its_answer() -> None:
    value = load_network(shipped_values()["car_navigation"])
    states = np.random.default_rng(0).uniform(-4.0, 4.0, (20 * ROWS + 1, 3))
    request, response = QueryValues.Request(), QueryValues.Response()
    request.states.frombytes(states.tobytes())
    tracemalloc.start()
    answer(value, request, response)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2 * 64 * 8 * len(states), "two layers for all states at once"
    some = np.array([0, ROWS - 1, ROWS, 20 * ROWS])
    values, gradients = value.value_and_gradient(states[some])
    assert np.array(response.values)[some] == pytest.approx(values)
    assert np.array(response.gradients).reshape(-1, 3)[some] == pytest.approx(gradients)
    assert len(response.in_domain) == len(response.values) == len(states)


def test_it_ends_cleanly_by_a_termination_too(run_node: Callable, tmp_path: Path) -> None:
    small_value().grids[0].save(tmp_path / "g.safetensors")  # a value grid does as well as a network
    node = run_node("oc_baseline_node", "baseline", f"grid:={tmp_path / 'g.safetensors'}")
    node.wait_for("task 'car_navigation'")
    code, _ = node.stop(signal.SIGTERM)
    assert code == 0, node.output
    assert "Traceback" not in node.output


def test_only_a_value_of_another_version_of_its_task_is_told_of(run_node: Callable) -> None:
    new = run_node("oc_baseline_node", "baseline", "grid:=car_navigation", "task:=car_navigation")
    new.wait_for("points")
    assert OTHER_VERSION not in new.output
    other = run_node("oc_baseline_node", "baseline", "grid:=car_navigation", "task:=quad_trap")
    assert other.process.wait(120.0) == 1
    assert "the value function belongs to task 'car_navigation', not 'quad_trap'" in other.output


def test_the_parameter_grid_tells_the_names_that_it_takes() -> None:
    (grid,) = (parameter for parameter in OcBaselineNode.PARAMETERS if parameter.name == "grid")
    assert grid.live
    assert ".safetensors" in grid.description
    assert all(name in grid.description for name in shipped_values())


@pytest.mark.parametrize("file", ["", "nowhere.safetensors"])
def test_without_a_value_it_ends_with_one_clear_message(run_node: Callable, file: str) -> None:
    node = run_node("oc_baseline_node", "baseline", f"grid:='{file}'")
    assert node.process.wait(120.0) in (1, 2)
    words = "no value 'nowhere.safetensors': there are car_navigation, " if file else "parameter 'grid' is empty"
    assert words in node.output
    assert len(node.output.strip().splitlines()) == 1


def test_a_time_to_reach_is_refused(run_node: Callable, tmp_path: Path) -> None:
    from dataclasses import replace

    grid = replace(small_value().grids[0], kind="time_to_reach", values=np.ones((21, 21, 8)))
    grid.save(tmp_path / "ttr.safetensors")
    node = run_node("oc_baseline_node", "baseline", f"grid:={tmp_path / 'ttr.safetensors'}")
    assert node.process.wait(120.0) == 2
    assert "holds 'time_to_reach', not 'oc_value'" in node.output
