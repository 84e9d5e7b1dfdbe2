"""Hostile requests to the parameter services of every node, as processes."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
from _attack import Attack
from ament_index_python.packages import get_package_prefix

NODES = {
    "sim_bridge": ("sim_bridge", "bridge", ()),
    "recorder": ("ctrl_rl_bags", "recorder", ("output:=bag",)),
    "watchdog": ("ctrl_rl_core", "watchdog", ()),
    "koopman_lqr_controller": ("koopman_lqr_controller", "controller", ()),
    "scripted_driver": ("koopman_lqr_controller", "scripted_driver", ()),
    "oc_baseline_node": ("oc_baseline_node", "baseline", ("grid:=car_navigation",)),
    "option_coordinator": ("option_coordinator", "coordinator", ("team:=delivery_team",)),
    "navigation_agent": ("option_coordinator", "navigation_agent", ("robot:=robot_1",)),
}
_REQUESTS = 60
_PATIENCE_S = 30.0
_NUMBERS = (0.0, -1.0, 1e308, -1e308, float("nan"), float("inf"), 5e-324)


def run(generator: np.random.Generator, folder: Path) -> None:
    """Send one node, drawn by the generator, many requests, and check that it answers all of them and lives on."""
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    import rclpy

    name = str(generator.choice(sorted(NODES)))
    package, executable, parameters = NODES[name]
    options = [part for each in parameters for part in ("-p", each)]
    command = [Path(get_package_prefix(package)) / "lib" / package / executable, "--ros-args", *options]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(command, cwd=folder, stdout=log, stderr=subprocess.STDOUT)
    rclpy.init()
    try:
        asker = _Asker(name)
        known = asker.names()
        for _ in range(_REQUESTS):
            asker.attack(generator, known)
            assert process.poll() is None, (folder / "log").read_text()[-3000:]
        assert set(known) <= set(asker.names()), "parameters are gone"
        process.send_signal(signal.SIGINT)
        assert process.wait(_PATIENCE_S) == 0, (folder / "log").read_text()[-3000:]
        assert "Traceback" not in (folder / "log").read_text()
    finally:
        process.kill()
        process.wait()
        rclpy.try_shutdown()


class _Asker:
    """Asks a node for its parameters."""

    def __init__(self, name: str) -> None:
        from rcl_interfaces import srv
        from rclpy.node import Node

        self._node, self._name = Node("attacker"), name
        self._kinds: dict[str, Any] = {
            "set_parameters": srv.SetParameters,
            "set_parameters_atomically": srv.SetParametersAtomically,
            "get_parameters": srv.GetParameters,
            "list_parameters": srv.ListParameters,
            "describe_parameters": srv.DescribeParameters,
            "get_parameter_types": srv.GetParameterTypes,
        }
        self._clients = {
            service: self._node.create_client(kind, f"{name}/{service}") for service, kind in self._kinds.items()
        }

    def names(self) -> list[str]:
        answer = self._call("list_parameters", self._kinds["list_parameters"].Request())
        return list(answer.result.names)

    def attack(self, generator: np.random.Generator, known: list[str]) -> None:
        service = str(generator.choice(list(self._kinds)))
        request = self._kinds[service].Request()
        count = int(generator.choice([0, 1, 3, 40, 2000]))
        if service.startswith("set"):
            request.parameters = [_parameter(generator, known) for _ in range(min(count, 40))]
        elif service == "list_parameters":
            request.prefixes = [_text(generator) for _ in range(count)]
            request.depth = (0, 1, 2**63, 2**64 - 1)[generator.integers(4)]
        else:
            request.names = [_name(generator, known) for _ in range(count)]
        answer = self._call(service, request)
        if service == "set_parameters":
            assert len(answer.results) == len(request.parameters), "an answer for each"

    def _call(self, service: str, request: Any) -> Any:
        import rclpy

        client, deadline = self._clients[service], time.monotonic() + _PATIENCE_S
        while not client.service_is_ready():
            assert time.monotonic() < deadline, f"{client.srv_name} is not there"
            rclpy.spin_once(self._node, timeout_sec=0.1)
        future = client.call_async(request)
        while not future.done():
            assert time.monotonic() < deadline + _PATIENCE_S, f"{client.srv_name} does not answer {str(request)[:500]}"
            rclpy.spin_once(self._node, timeout_sec=0.1)
        return future.result()


def _parameter(generator: np.random.Generator, known: list[str]) -> Any:
    from rcl_interfaces.msg import Parameter, ParameterValue

    value = ParameterValue(type=int(generator.choice([*range(10), 10, 77, 255])))
    value.bool_value = bool(generator.integers(2))
    value.integer_value = (0, 1, -1, 2**63 - 1, -(2**63))[generator.integers(5)]
    value.double_value = float(generator.choice(_NUMBERS))
    value.string_value = _text(generator)
    value.string_array_value = [_text(generator) for _ in range(int(generator.integers(3)))]
    value.double_array_value = [float(generator.choice(_NUMBERS))]
    return Parameter(name=_name(generator, known), value=value)


def _name(generator: np.random.Generator, known: list[str]) -> str:
    return str(generator.choice(known)) if generator.random() < 0.8 else _text(generator)


def _text(generator: np.random.Generator) -> str:
    """Return a text; the longest are a megabyte."""
    texts = (
        "",
        "a",
        "../../x",
        "~",
        "~nobody/x",
        "/",
        "/dev/zero",
        "/proc/self/mem",
        "\n\x1b[2J",
        "\u202e",
        "%s%n",
        "nan",
    )
    pick = int(generator.integers(len(texts) + 2))
    return (
        texts[pick] if pick < len(texts) else "x" * int(generator.choice([300, 5000, 1_000_000], p=[0.5, 0.45, 0.05]))
    )


ATTACKS = (
    Attack(
        "parameters",
        "Whatever is asked of the parameter services, each request is answered and the node lives on.",
        run,
        limit_s=180.0,
    ),
)
