"""The shipped SROS2 policy allows each name that the nodes really use, and only the watchdog to move the robot."""

import time
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

POLICY = Path(__file__).parents[1] / "config" / "security.policy.xml"
RAW = "cmd_vel:=cmd_vel_raw"
NODES = (
    ("koopman_lqr_controller", "controller", "koopman_lqr_controller", (RAW,), ()),
    ("ctrl_rl_core", "policy", "policy", (RAW,), ("policy:=curved_corridor",)),
    ("ctrl_rl_safety", "safety_filter", "safety_filter", ("cmd_vel:=cmd_vel_safe",), ("use_map:=true",)),
    ("ctrl_rl_safety", "flight_guard", "flight_guard", ("rotor_thrusts:=rotor_thrusts_safe",), ()),
    ("ctrl_rl_core", "watchdog", "watchdog", (), ()),
    ("ctrl_rl_core", "thrust_watchdog", "thrust_watchdog", (), ()),
    ("ctrl_rl_navigation", "navigator", "navigator", (RAW,), ()),
    ("ctrl_rl_navigation", "map_server", "map_server", (), ("map:=maze",)),
    ("ctrl_rl_bags", "recorder", "recorder", (), ("output:={folder}/bag",)),
    ("oc_baseline_node", "baseline", "oc_baseline_node", (), ("grid:=curved_corridor",)),
    ("option_coordinator", "coordinator", "option_coordinator", (), ("team:=delivery_team", "policy:=spread")),
    ("option_coordinator", "navigation_agent", "navigation_agent", (RAW, "__ns:=/robot_1"), ("team:=delivery_team",)),
)
_READY_S = 60.0


def profiles() -> dict[str, ET.Element]:
    """Return the profiles by full node name."""
    found = ET.parse(POLICY).iter("profile")
    return {f"{profile.attrib['ns'].rstrip('/')}/{profile.attrib['node']}": profile for profile in found}


def allowed(profile: ET.Element, right: str) -> list[str]:
    """Return the full names, or patterns of them, that a profile allows to publish, subscribe, reply or request."""
    space = profile.attrib["ns"].rstrip("/")
    out = []
    for block in profile:
        for name in (entry.text or "" for entry in block if block.get(right) == "ALLOW"):
            own = name.replace("~", f"{space}/{profile.attrib['node']}")
            out.append(own if own.startswith(("/", "*")) else f"{space}/{own}")
    parts = {"publish": ("feedback", "status"), "reply": ("send_goal", "cancel_goal", "get_result")}.get(right, ())
    for name in (entry.text for block in profile if block.get("execute") == "ALLOW" for entry in block):
        out += [f"{space}/{name}/_action/{part}" for part in parts]
    return out


@pytest.fixture
def lookout() -> Iterator[Node]:
    context = Context()
    rclpy.init(context=context)
    node = Node("lookout", context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


def graph_of(node: Node, name: str, space: str) -> dict[str, set[str]]:
    """Return the names that a node publishes, subscribes to, answers and calls."""
    ways = {
        "publish": node.get_publisher_names_and_types_by_node,
        "subscribe": node.get_subscriber_names_and_types_by_node,
        "reply": node.get_service_names_and_types_by_node,
        "request": node.get_client_names_and_types_by_node,
    }
    return {right: {topic for topic, _ in ask(name, space)} for right, ask in ways.items()}


@pytest.mark.parametrize(("package", "executable", "name", "remap", "parameters"), NODES, ids=lambda value: str(value))
def test_a_node_uses_only_what_its_profile_allows(
    lookout: Node, run_node, tmp_path: Path, package: str, executable: str, name: str, remap, parameters
) -> None:
    space = "/robot_1" if "__ns:=/robot_1" in remap else ""
    run_node(package, executable, *(text.format(folder=tmp_path) for text in parameters), remap=remap)
    deadline = time.monotonic() + _READY_S
    while (name, space or "/") not in lookout.get_node_names_and_namespaces():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    time.sleep(1.0)  # its last publisher is there after its first
    profile = profiles()[f"{space}/{name}"]
    seen = graph_of(lookout, name, space or "/")
    assert "/diagnostics" in seen["publish"]
    refused = {
        f"{right} {used}"
        for right, names in seen.items()
        for used in names - {f"{space}/{name}/get_type_description"}
        if not any(fnmatchcase(used, pattern) for pattern in allowed(profile, right))
    }
    assert not refused, f"add them to {POLICY}"


def test_only_watchdogs_may_move_a_robot() -> None:
    rights = {node: allowed(profile, "publish") for node, profile in profiles().items()}
    moves = ("/cmd_vel", "/rotor_thrusts")
    movers = {node for node, names in rights.items() if any(name.endswith(moves) for name in names)}
    watchdogs = {"/watchdog", "/thrust_watchdog", "/robot_1/watchdog", "/robot_2/watchdog", "/robot_3/watchdog"}
    assert movers == watchdogs
    assert not any("*" in name for names in rights.values() for name in names)
