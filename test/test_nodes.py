"""What every node of the suite promises, tried on real processes."""

import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from ament_index_python.packages import get_package_prefix
from commands import command
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

from ttr_reward_node import solve_task

NODES = {
    "bridge": ("sim_bridge", ()),
    "recorder": ("ctrl_rl_bags", ("output:={folder}/bag",)),
    "watchdog": ("ctrl_rl_core", ()),
    "policy": ("ctrl_rl_core", ("policy:=curved_corridor",)),
    "controller": ("koopman_lqr_controller", ()),
    "scripted_driver": ("koopman_lqr_controller", ()),
    "reward": ("ttr_reward_node", ("grid:={grid}",)),
    "coordinator": ("option_coordinator", ("team:=delivery_team",)),
    "navigation_agent": ("option_coordinator", ("robot:=robot_1",)),
    "navigator": ("ctrl_rl_navigation", ("map:=maze",)),
    "map_server": ("ctrl_rl_navigation", ("map:=maze",)),
    "safety_filter": ("ctrl_rl_safety", ()),
    "flight_guard": ("ctrl_rl_safety", ()),
}
FULL_NAMES = {
    "bridge": "/sim_bridge",
    "controller": "/koopman_lqr_controller",
    "reward": "/ttr_reward_node",
    "coordinator": "/option_coordinator",
}
"""Nodes with another name than their executable."""
BAD = {
    "bridge": ("task:=nowhere", "no task 'nowhere'"),
    "recorder": ("output:={folder}", "exists"),
    "watchdog": ("timeout:=0.0", "parameter 'timeout' is out of range: must be 0.05 to 60"),
    "policy": ("policy:=nobody", "no policy 'nobody': there are"),
    "controller": ("scan_timeout:=-1.0", "parameter 'scan_timeout' is out of range: must be 0.05 to 10"),
    "scripted_driver": ("speed:=fast", "parameter 'speed' is 'fast': must be a number"),
    "reward": ("grid:={folder}/none.safetensors", "none.safetensors: there is no such file"),
    "coordinator": ("team:=nobody", "no team 'nobody'"),
    "navigation_agent": ("robot:=nobody", "team 'delivery_team' has robot_1"),
    "navigator": ("map:={folder}/none.yaml", "none.yaml: there is no such file"),
    "map_server": ("map:=nowhere", "no map 'nowhere': there are corridor, maze, warehouse"),
    "flight_guard": ("task:=car_ttr", "task 'car_ttr' has no planar quadrotor"),
    "safety_filter": ("robot:=nobody", "no robot 'nobody': there are jackal"),
}


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("grids") / "car.safetensors"
    solve_task("car_ttr", counts=(31, 31, 24)).save(path)
    return path


@pytest.fixture
def start(run_node: Callable, tmp_path: Path, grid: Path) -> Callable:
    def run(name: str, *more: str):
        package, parameters = NODES[name]
        own = (text.format(folder=tmp_path, grid=grid) for text in parameters)
        return run_node(package, name, *own, *more, anew=True)  # start and end are tried as they are

    return run


@pytest.fixture
def listener():
    rclpy.init()
    node = Node("listener")
    heard: dict[str, DiagnosticArray] = {}

    def keep(message: DiagnosticArray) -> None:
        heard[message.status[0].name] = message

    node.create_subscription(DiagnosticArray, "diagnostics", keep, 10)
    yield node, heard
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.mark.parametrize("name", NODES)
def test_a_bad_parameter_ends_it_with_one_clear_message(run_node: Callable, tmp_path: Path, name: str) -> None:
    parameter, words = BAD[name]
    package, _ = NODES[name]
    process = run_node(package, name, parameter.format(folder=tmp_path))
    assert process.process.wait(120.0) in (1, 2)
    assert words in process.output
    assert "Traceback" not in process.output
    assert len(process.output.strip().splitlines()) == 1


@pytest.mark.parametrize("name", NODES)
def test_help_names_every_parameter_with_default_and_range(name: str) -> None:
    package, _ = NODES[name]
    answer = command(name, "--help", package=package)
    assert answer.returncode == 0, answer.stderr
    assert "parameters:" in answer.stdout
    assert answer.stdout.count("(default ") >= 3


def _dump(node: Node, name: str) -> dict[str, object]:
    """Return the parameters of a node, as `ros2 param dump` writes them."""

    def ask(kind: type, service: str, request: object) -> object:
        client = node.create_client(kind, f"{name}/{service}")
        assert client.wait_for_service(30.0)
        future = client.call_async(request)
        rclpy.spin_until_future_complete(node, future, timeout_sec=30.0)
        node.destroy_client(client)
        return future.result()

    names = sorted(ask(ListParameters, "list_parameters", ListParameters.Request()).result.names)
    values = ask(GetParameters, "get_parameters", GetParameters.Request(names=names)).values
    return {key: parameter_value_to_python(value) for key, value in zip(names, values, strict=True)}


def _end(process: Any, number: int) -> None:
    code, _ = process.stop(number)
    assert code == 0, process.output
    assert "Traceback" not in process.output


@pytest.mark.fault
@pytest.mark.parametrize("name", NODES)
def test_a_node_tells_diagnostics_dumps_and_loads_its_parameters_and_ends_in_good_order(
    start: Callable, run_node: Callable, listener: tuple, tmp_path: Path, name: str
) -> None:
    node, heard = listener

    def wait(process: Any) -> DiagnosticArray:
        heard.clear()
        deadline = time.monotonic() + 300.0  # a first start compiles
        while time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.05)
            if heard:
                return next(iter(heard.values()))
            assert process.process.poll() is None, process.output
        raise AssertionError(process.output)

    first = start(name)
    said = wait(first)
    while name == "bridge" and said.header.stamp.sec == 0:  # simulation time begins at 0
        said = wait(first)
    full_name = said.status[0].name
    assert full_name == FULL_NAMES.get(name, f"/{name}")
    assert said.header.stamp.sec > 0 or name == "recorder"
    assert said.status[0].message
    assert said.status[0].values
    dumped = _dump(node, full_name)
    _end(first, signal.SIGINT)
    file = tmp_path / "dumped.yaml"
    again = {**dumped, "output": str(tmp_path / "again")} if "output" in dumped else dumped
    file.write_text(yaml.safe_dump({full_name: {"ros__parameters": again}}, default_flow_style=False))
    package, _ = NODES[name]
    second = run_node(package, name, params_file=file)
    assert _dump(node, wait(second).status[0].name) == again
    assert "unknown to this node" not in second.output
    _end(second, signal.SIGTERM)


@pytest.mark.parametrize("name", ["bag", "recorder"])
def test_a_command_that_moved_runs_under_its_old_name_and_says_the_new_one(name: str) -> None:
    old, new = (
        Path(get_package_prefix(package)) / "lib" / package / name for package in ("ctrl_rl_core", "ctrl_rl_bags")
    )
    before, now = (subprocess.run([file, "--help"], capture_output=True, text=True, check=True) for file in (old, new))
    assert before.stdout == now.stdout
    assert before.stderr == f"{name}: this command is now `ros2 run ctrl_rl_bags {name}`\n{now.stderr}"
