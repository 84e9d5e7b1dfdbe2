"""The pages of node parameters, and of topics and services from the ROS graph of running nodes."""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import rclpy
from ament_index_python.packages import get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray
from workspace import Executable, executables

from ctrl_rl_core import SuiteNode

_START_S = 90.0
_SETTLE_S = 2.0
"""Time from a node's first diagnostics, when all its topics exist, until the graph shows them."""
_OWN = {"/rosout", "/parameter_events", "/clock"}
_OWN_TYPES = ("rcl_interfaces/srv/", "type_description_interfaces/srv/")
_PARAMETERS = """# Parameters

Every parameter of every node, from the tables that the nodes use for their checks. `ros2 run PACKAGE NODE --help` and
`ros2 param describe` print the same. Set one by `--ros-args -p NAME:=VALUE` or a `--params-file`; `live` ones also by
`ros2 param set` while the node runs. [What every node does](../nodes.md) says how values are checked.
"""
_TOPICS = """# Topics and services

Each node's publications, subscriptions and services, from the ROS graph of the running node. Names are relative:
they can be remapped, and follow the node's namespace. `/diagnostics` is absolute. A name that begins with the
node's own name, `/sim_bridge/...`, is private to it (`~/...`). [Messages](messages.md) has the types of `ctrl_rl_msgs`.
"""


class NodeError(Exception):
    """A node does not start, or does not appear in the graph."""


class RunningNode(NamedTuple):
    """How to start a node for the page, with the parameters that it needs to start and to create its topics."""

    package: str
    executable: str
    parameters: tuple[str, ...] = ()


_RUNNING = (
    RunningNode("sim_bridge", "bridge", ("task:=curved_corridor",)),
    RunningNode("koopman_lqr_controller", "controller"),
    RunningNode("koopman_lqr_controller", "scripted_driver"),
    RunningNode("ctrl_rl_core", "policy", ("policy:=curved_corridor",)),
    RunningNode("ctrl_rl_core", "watchdog"),
    RunningNode("ctrl_rl_core", "thrust_watchdog"),
    RunningNode("ttr_reward_node", "reward", ("grid:={grid}",)),
    RunningNode("oc_baseline_node", "baseline", ("grid:=curved_corridor",)),
    RunningNode("option_coordinator", "coordinator", ("team:=delivery_team", "policy:=delivery_team")),
    RunningNode("option_coordinator", "navigation_agent", ("team:=delivery_team", "robot:=robot_1")),
    RunningNode("ctrl_rl_navigation", "map_server", ("map:=maze",)),
    RunningNode("ctrl_rl_navigation", "navigator"),
    RunningNode("ctrl_rl_safety", "safety_filter"),
)


def parameter_page() -> str:
    """Return the page of parameters, with one table per node."""
    parts = [_PARAMETERS]
    for executable in executables():
        for kind in _node_kinds(executable):
            parts.append(f"## {executable.name} ({executable.package})\n")
            parts.append((kind.__doc__ or "").strip().splitlines()[0] + "\n")
            parts.append("| parameter | default | allowed | live | meaning |\n|---|---|---|---|---|")
            parts += [
                f"| `{each.name}` | `{_shown(each.default)}` | {each.limits} | {'yes' if each.live else ''} "
                f"| {each.description.replace('|', chr(92) + '|')} |"
                for each in kind.PARAMETERS
            ]
            parts.append("")
    return "\n".join(parts)


def topic_page() -> str:
    """Return the page of topics and services, from starting each node and reading the graph.

    Raises:
        NodeError: A node does not start.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)  # other running nodes do not belong on the page
    with tempfile.TemporaryDirectory() as folder:
        grid = Path(folder) / "car_ttr.safetensors"
        _solve(grid)
        rclpy.init()
        try:
            observer = rclpy.create_node("documentation")
            diagnosed: list[DiagnosticArray] = []
            observer.create_subscription(DiagnosticArray, "/diagnostics", diagnosed.append, 10)
            parts = [_TOPICS, *(_section(observer, each, grid, diagnosed) for each in _RUNNING)]
            observer.destroy_node()
        finally:
            rclpy.try_shutdown()
    return "\n".join(parts)


def _node_kinds(executable: Executable) -> list[type[SuiteNode]]:
    """Return the node classes that an executable's module defines or runs; empty if it is no node."""
    if "node" not in executable.module and "agent" not in executable.module:
        return []
    members = vars(import_module(executable.module)).values()
    kinds = [each for each in members if isinstance(each, type) and issubclass(each, SuiteNode)]
    return [each for each in kinds if each.__module__ == executable.module]


def _shown(default: Any) -> str:
    return repr(default) if isinstance(default, str) else str(default).lower()


def _solve(grid: Path) -> None:
    """Write a time-to-reach grid, which the reward node needs."""
    _checked([_path("ttr_reward_node", "solve"), "--task", "car_ttr", "--output", str(grid)])


def _section(observer: Any, running: RunningNode, grid: Path, diagnosed: list[DiagnosticArray]) -> str:
    arguments = [part for each in running.parameters for part in ("-p", each.format(grid=grid))]
    command = [_path(running.package, running.executable), *(("--ros-args", *arguments) if arguments else ())]
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        try:
            name, space = _wait_for_node(observer, process, log, diagnosed)
            return _tables(observer, running, name, space)
        finally:
            process.terminate()
            process.wait()
            _wait_until_alone(observer)


def _others(observer: Any) -> list[tuple[str, str]]:
    return [each for each in observer.get_node_names_and_namespaces() if each[0] != "documentation"]


def _wait_for_node(
    observer: Any, process: subprocess.Popen[bytes], log: Any, diagnosed: list[DiagnosticArray]
) -> tuple[str, str]:
    diagnosed.clear()
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline and process.poll() is None:
        rclpy.spin_once(observer, timeout_sec=0.1)
        found = _others(observer)
        if found and diagnosed:
            end = time.monotonic() + _SETTLE_S
            while time.monotonic() < end:
                rclpy.spin_once(observer, timeout_sec=0.1)
            if found[0] in _others(observer):
                return found[0]
    log.seek(0)
    raise NodeError(f"{process.args}: no node seen. It said: {log.read().decode(errors='replace')}")


def _wait_until_alone(observer: Any) -> None:
    deadline = time.monotonic() + _START_S
    while others := _others(observer):
        if time.monotonic() > deadline:
            raise NodeError(f"node {others[0][0]} stays in the graph: is it another program's? End it, and try again")
        rclpy.spin_once(observer, timeout_sec=0.1)


def _tables(observer: Any, running: RunningNode, name: str, space: str) -> str:
    lines = [f"## {running.executable} ({running.package})\n", "| | name | type |", "|---|---|---|"]
    for words, ask in (
        ("publishes", observer.get_publisher_names_and_types_by_node),
        ("subscribes", observer.get_subscriber_names_and_types_by_node),
        ("serves", observer.get_service_names_and_types_by_node),
    ):
        for topic, (kind, *_) in sorted(ask(name, space)):
            if topic not in _OWN and not kind.startswith(_OWN_TYPES):
                lines.append(f"| {words} | `{topic}` | {kind.replace('/msg/', '/').replace('/srv/', '/')} |")
    return "\n".join(lines) + "\n"


def _path(package: str, executable: str) -> str:
    return f"{get_package_prefix(package)}/lib/{package}/{executable}"


def _checked(command: list[str]) -> None:
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    if answer.returncode:
        raise NodeError(f"{command[0]} ended with {answer.returncode}: {answer.stderr}")
