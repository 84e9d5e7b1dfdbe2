"""The reward node as a process: values, rewards, grids, slices, queries, reloads."""

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from ctrl_rl_core.ros import LATCHED, ODOM_PUBLISHER, to_stamp
from nav_msgs.msg import OccupancyGrid, Odometry
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from std_srvs.srv import Trigger
from ttr_reward_node.rewards.progress import PER_SECOND
from ttr_reward_node.rewards.rewards import longest_time
from ttr_reward_node.solvers.decomposition import PLANAR_QUADROTOR_FIVE

from ctrl_rl_core import RESULT, ValueGrid
from ctrl_rl_msgs.msg import StateValue, TaskOutcome, TaskReward
from ctrl_rl_msgs.msg import ValueGrid as ValueGridMsg
from ctrl_rl_msgs.srv import QueryValues
from ttr_reward_node import DecomposedValue, solve_decomposed, solve_task

NODE = "ttr_reward_node"
FREE, GOAL, CUBE, OUTSIDE = (0.0, -3.0, 1.0), (4.0, 4.0, 0.75), (0.0, 0.1, 0.0), (7.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("grids") / "car.safetensors"
    solve_task("car_ttr", counts=(51, 51, 36)).save(path)
    return path


@pytest.fixture(scope="module")
def car_node(run_shared_node: Callable, grid: Path) -> Any:
    """Run a node with the car's function, shared by the tests that only query it."""
    return run_shared_node(NODE, "reward", f"grid:={grid}", "slice:=['theta=1.57']")


@pytest.fixture(scope="module")
def quad(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("grids") / "quad.safetensors"
    counts = {"x": 21, "z": 21, "v_x": 11, "v_z": 11, "psi": 12, "omega": 7}
    solve_decomposed("quad_ttr", PLANAR_QUADROTOR_FIVE, counts=counts).save(path)
    return path


def odometry(state: tuple[float, float, float], stamp: int) -> Odometry:
    message = Odometry()
    message.header.stamp = to_stamp(stamp)
    message.header.frame_id = "odom"
    x, y, theta = state
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(theta / 2), math.cos(theta / 2)
    return message


class Peer:
    """Client of the node: publishes odometry, stores the answers, and calls the services of a named node."""

    def __init__(self) -> None:
        self.asked = NODE
        rclpy.init()
        self.node = Node("peer")
        self.odom = self.node.create_publisher(Odometry, "odom", ODOM_PUBLISHER)
        self.heard: dict[str, list[Any]] = {}
        self.listen(TaskReward, "reward", RESULT)
        self.listen(StateValue, "time_to_reach", RESULT)

    def listen(self, kind: type, topic: str, qos: Any) -> list[Any]:
        self.heard[topic] = []
        self.node.create_subscription(kind, topic, self.heard[topic].append, qos)
        return self.heard[topic]

    def until(self, done: Callable[[], bool], seconds: float = 120.0) -> None:
        deadline = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < deadline, "waited in vain"
            rclpy.spin_once(self.node, timeout_sec=0.02)

    def call(self, kind: type, service: str, **fields: Any) -> Any:
        client = self.node.create_client(kind, f"{self.asked}/{service}")
        assert client.wait_for_service(120.0)
        future = client.call_async(kind.Request(**fields))
        self.until(future.done)
        return future.result()

    def set(self, name: str, value: ParameterValue) -> Any:
        return self.call(SetParameters, "set_parameters", parameters=[Parameter(name=name, value=value)]).results[0]

    def ask(self, state: tuple[float, float, float], stamp: int) -> tuple[TaskReward, StateValue]:
        message = odometry(state, stamp)
        answers = [self.heard[topic] for topic in ("reward", "time_to_reach")]
        before = [len(answer) for answer in answers]
        deadline = time.monotonic() + 120.0
        while any(len(answer) == count for answer, count in zip(answers, before, strict=True)):
            assert time.monotonic() < deadline
            self.odom.publish(message)
            self.until(lambda: True)
            for _ in range(10):
                rclpy.spin_once(self.node, timeout_sec=0.02)
        return answers[0][-1], answers[1][-1]


@pytest.fixture
def peer() -> Iterator[Peer]:
    peer = Peer()
    yield peer
    peer.node.destroy_node()
    rclpy.try_shutdown()


@pytest.mark.usefixtures("car_node")
def test_each_state_is_valued_and_paid_as_the_task_says(peer: Peer, grid: Path) -> None:
    function = ValueGrid.load(grid)
    reward, value = peer.ask(FREE, 7)
    phi, gradient = function.value_and_gradient(FREE)
    assert reward.header.stamp == to_stamp(7)
    assert reward.outcome.value == TaskOutcome.RUNNING
    assert (reward.reward, reward.time_to_reach) == (pytest.approx(-phi), pytest.approx(phi))
    assert (value.value, value.in_domain, value.header.frame_id) == (pytest.approx(phi), True, "map")
    np.testing.assert_allclose(value.state, FREE, atol=1e-12)
    np.testing.assert_allclose(value.gradient, gradient, atol=1e-9)
    reward, value = peer.ask(GOAL, 8)
    assert (reward.outcome.value, reward.reward, value.value) == (TaskOutcome.GOAL, 1000.0, 0.0)
    reward, _ = peer.ask(CUBE, 9)
    assert (reward.outcome.value, reward.reward) == (TaskOutcome.COLLISION, -400.0)


def test_best_progress_is_paid_once_an_episode(peer: Peer, run_node: Callable, grid: Path) -> None:
    renamed = ("__node:=progress_node", "reward:=progress", "time_to_reach:=other_time")
    node = run_node(NODE, "reward", f"grid:={grid}", "reward:=ttr_progress", remap=renamed)
    node.wait_for("points")
    peer.asked, paid = "progress_node", peer.listen(TaskReward, "progress", RESULT)
    near, far = FREE, (-4.0, -4.0, 1.0)
    times = ValueGrid.load(grid).value([far, near])

    def total(state: tuple[float, float, float], stamp: int) -> float:
        """Return the sum of rewards up to the answer for a state; a lost message is sent again."""
        turn = 0  # not resent at once: the copy could be read after the next service call
        while not any(each.header.stamp == to_stamp(stamp) for each in paid):
            if turn % 20 == 0:
                peer.odom.publish(odometry(state, stamp))
            rclpy.spin_once(peer.node, timeout_sec=0.1)
            turn += 1
        return sum(each.reward for each in paid)

    gained = PER_SECOND * (times[0] - times[1])
    assert [total(far, 1), total(near, 2), total(far, 3), total(near, 4)] == pytest.approx([0.0, *[gained] * 3])
    assert peer.call(Trigger, "begin_episode").success
    assert [total(far, 5), total(near, 6)] == pytest.approx([gained, 2.0 * gained])


def test_outside_the_grid_it_says_so(peer: Peer, car_node: Any, grid: Path) -> None:
    reward, value = peer.ask((4.5, -4.5, -0.8), 1)  # on the grid, but too close to the wall to turn away
    assert math.isinf(value.value)
    assert reward.reward == pytest.approx(-longest_time(ValueGrid.load(grid)), abs=1e-9)
    _, value = peer.ask(OUTSIDE, 2)
    assert not value.in_domain
    assert math.isnan(value.value)
    car_node.wait_for("outside the grid: x = 7, y = 0, theta = 0")


@pytest.mark.usefixtures("car_node")
def test_latecomers_get_grid_and_slice_and_many_states_are_answered_at_once(peer: Peer, grid: Path) -> None:
    grids = peer.listen(ValueGridMsg, f"{NODE}/grid", LATCHED)
    slices = peer.listen(OccupancyGrid, f"{NODE}/slice", LATCHED)
    peer.until(lambda: bool(grids) and bool(slices))
    function = ValueGrid.load(grid)
    assert [axis.count for axis in grids[0].axes] == [51, 51, 36]
    assert (grids[0].grid_digest, grids[0].kind) == (function.digest, "time_to_reach")
    np.testing.assert_array_equal(np.array(grids[0].values, np.float32), function.values.ravel())
    info, cells = slices[0].info, np.array(slices[0].data).reshape(slices[0].info.height, slices[0].info.width)
    column, row = (
        round((0.0 - info.origin.position.x) / info.resolution),
        round((-3.0 - info.origin.position.y) / info.resolution),
    )
    assert 0 < cells[row, column] <= 100
    assert cells.min() == -1
    states = np.array([FREE, GOAL, OUTSIDE])
    answer = peer.call(QueryValues, "query", states=states.ravel().tolist())
    assert answer.success
    np.testing.assert_allclose(answer.values, function.value(states))
    assert answer.in_domain == [True, True, False]
    answer = peer.call(QueryValues, "query", states=[1.0, 2.0])
    assert not answer.success
    assert answer.message == "2 numbers are not a multiple of 3: x, y, theta"


@pytest.mark.usefixtures("car_node")
def test_a_grid_that_is_refused_late_changes_nothing(peer: Peer, quad: Path) -> None:
    before, _ = peer.ask(FREE, 1)
    answer = peer.set("grid", ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=str(quad)))
    assert not answer.successful
    assert "theta" in answer.reason
    after, value = peer.ask(FREE, 2)
    assert (after.reward, after.time_to_reach) == (before.reward, before.time_to_reach)
    assert value.in_domain


@pytest.mark.usefixtures("car_node")
def test_another_grid_is_loaded_while_it_runs_and_a_wrong_one_refused(peer: Peer, tmp_path: Path) -> None:
    """Runs last of the tests that share the node, because it loads another function."""
    first, _ = peer.ask(FREE, 1)
    other = tmp_path / "other.safetensors"
    solve_task("car_ttr", counts=(31, 31, 24), inflation=0.177).save(other)
    text = ParameterType.PARAMETER_STRING
    answer = peer.set("grid", ParameterValue(type=text, string_value=str(tmp_path / "nowhere.safetensors")))
    assert not answer.successful
    assert "there is no such file" in answer.reason
    again, _ = peer.ask(FREE, 2)
    assert again.time_to_reach == first.time_to_reach
    assert peer.set("grid", ParameterValue(type=text, string_value=str(other))).successful
    second, _ = peer.ask(FREE, 3)
    assert second.time_to_reach == pytest.approx(float(ValueGrid.load(other).value(FREE)))
    assert second.time_to_reach != first.time_to_reach
    solve_task("car_ttr", counts=(35, 35, 24)).save(other, overwrite=True)
    assert peer.call(Trigger, "reload").success
    third, _ = peer.ask(FREE, 4)
    assert third.time_to_reach == pytest.approx(float(ValueGrid.load(other).value(FREE)))


@pytest.mark.parametrize(
    ("parameter", "words"),
    [
        ("grid:=''", "parameter 'grid' is empty"),
        ("grid:=nowhere.safetensors", "nowhere.safetensors: there is no such file"),
    ],
)
def test_a_bad_parameter_ends_it_with_one_clear_message(run_node: Callable, parameter: str, words: str) -> None:
    node = run_node(NODE, "reward", parameter)
    assert node.process.wait(120.0) != 0
    assert words in node.output
    assert "Traceback" not in node.output


def test_a_function_of_another_task_is_refused(run_node: Callable, grid: Path) -> None:
    node = run_node(NODE, "reward", f"grid:={grid}", "task:=car_navigation")
    assert node.process.wait(120.0) != 0
    assert "the value function belongs to task 'car_ttr', not 'car_navigation'" in node.output
    assert "Traceback" not in node.output


@pytest.fixture(scope="module")
def quad_node(run_shared_node: Callable, quad: Path) -> Any:
    """Run a node with the quadrotor's function, under its own name next to the car's node."""
    return run_shared_node(NODE, "reward", f"grid:={quad}", remap=("__node:=quad_node",))


@pytest.mark.usefixtures("quad_node")
def test_a_decomposed_function_is_served_like_a_single_one(peer: Peer, quad: Path) -> None:
    peer.asked = "quad_node"
    function = DecomposedValue.load(quad)
    heard = {name: peer.listen(ValueGridMsg, f"quad_node/{name}", LATCHED) for name in ("grid_x", "grid_v_z_psi")}
    states = np.array([[3.0, 0.0, 3.0, 0.0, 0.1, 0.0], [0.0, 1.0, 8.0, -1.0, 0.0, 0.5], [9.0, 0.0, 3.0, 0.0, 0.0, 0.0]])
    answer = peer.call(QueryValues, "query", states=states.ravel().tolist())
    np.testing.assert_allclose(answer.values, function.value(states))
    np.testing.assert_allclose(answer.gradients, function.value_and_gradient(states)[1].ravel())
    assert list(answer.in_domain) == [True, True, False]
    peer.until(lambda: all(heard.values()))
    assert list(heard["grid_v_z_psi"][0].values) == pytest.approx(function.grids[4].values.ravel())


@pytest.mark.usefixtures("quad_node")
def test_what_is_no_longer_served_is_no_longer_latched(peer: Peer, grid: Path) -> None:
    """Runs last of the tests that share the node."""
    peer.asked = "quad_node"
    parts = "/quad_node/grid_x"
    peer.until(lambda: len(peer.node.get_publishers_info_by_topic(parts)) == 1)
    text = ParameterType.PARAMETER_STRING
    assert peer.set("grid", ParameterValue(type=text, string_value=str(grid))).successful
    peer.until(lambda: not peer.node.get_publishers_info_by_topic(parts))
    assert len(peer.node.get_publishers_info_by_topic("/quad_node/grid")) == 1
