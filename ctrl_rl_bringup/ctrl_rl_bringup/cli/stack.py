"""The executable `stack`: a driver, the safety filter and the recorder as nodes of one process."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import NamedTuple

from ctrl_rl_core.ros import run_nodes

from ctrl_rl_core import ParameterError, SuiteNode

_HELP = """usage: stack [NODE ...] [--ros-args -p NAME:=VALUE ... -r FROM:=TO ...]

Runs several nodes in one process, which takes less memory than a process for each: on a Raspberry Pi, for example. The
driver commands on cmd_vel_raw, and the safety filter, if there is one, on cmd_vel_safe. The watchdog is not among
them: it has to survive them, so start it as a process of its own:
  ros2 run ctrl_rl_core watchdog --ros-args -r cmd_vel_raw:=cmd_vel_safe

nodes (default: controller safety_filter):
  controller     drives by a Koopman policy (ros2 run koopman_lqr_controller controller)
  policy         drives by any other policy (ros2 run ctrl_rl_core policy)
  navigator      drives to goals on a map (ros2 run ctrl_rl_navigation navigator)
  safety_filter  passes the commands after which the robot can still stop (ros2 run ctrl_rl_safety safety_filter)
  recorder       records a bag (ros2 run ctrl_rl_bags recorder)

A parameter goes to each node that has it, NODE:NAME:=VALUE to one node by its ROS name. The --help of a node lists its
parameters. An error that ends the recorder leaves the others running; one that ends another node ends all, and the
watchdog stops the robot."""


class Member(NamedTuple):
    """A node that a stack can hold.

    Attributes:
        module: Module with the node's class.
        kind: Name of the class.
        node: Name of the node in the ROS graph.
        commands: Topic for the node's cmd_vel; empty if it sends no commands.
        drives: Whether it decides where to drive; a stack holds one such node at most.
    """

    module: str
    kind: str
    node: str
    commands: str = ""
    drives: bool = False


MEMBERS = {
    "controller": Member("koopman_lqr_controller.nodes", "Controller", "koopman_lqr_controller", "cmd_vel_raw", True),
    "policy": Member("ctrl_rl_core.policies", "PolicyNode", "policy", "cmd_vel_raw", True),
    "navigator": Member("ctrl_rl_navigation.nodes", "NavigatorNode", "navigator", "cmd_vel_raw", True),
    "safety_filter": Member("ctrl_rl_safety.nodes", "SafetyFilterNode", "safety_filter", "cmd_vel_safe"),
    "recorder": Member("ctrl_rl_bags.recording", "RecorderNode", "recorder"),
}
_DEFAULT = ("controller", "safety_filter")
_PARAMETER_FLAGS = ("-p", "--param")


def stack() -> int:
    """Run the chosen nodes; the exit codes are those of any node."""
    program, *words = sys.argv
    begin = words.index("--ros-args") if "--ros-args" in words else len(words)
    if "-h" in words[:begin] or "--help" in words[:begin]:
        print(_HELP)
        return 0
    try:
        members = chosen(words[:begin])
    except ParameterError as error:
        print(f"{program.rsplit('/', 1)[-1]}: {error}", file=sys.stderr)
        return 2
    kinds = {member.node: _load(member) for member in members}
    wiring = [f"{member.node}:cmd_vel:={member.commands}" for member in members if member.commands]
    # The first rule that fits a name counts: a user's rule for cmd_vel must not lead a driver past the filter.
    rules = [word for rule in wiring for word in ("-r", rule)]
    given = [program, "--ros-args", *rules, "--", *_addressed(words[begin:], kinds)]
    return run_nodes(list(kinds.values()), given)


def chosen(names: Sequence[str]) -> list[Member]:
    """Return the members of a stack by their names, by default a controller and the filter.

    Raises:
        ParameterError: An unknown name, one given twice, or several drivers.
    """
    names = names or _DEFAULT
    for name in names:
        if name not in MEMBERS:
            raise ParameterError(f"no node '{name}': take {', '.join(MEMBERS)}")
        if names.count(name) > 1:
            raise ParameterError(f"'{name}' is named twice")
    drivers = [name for name in names if MEMBERS[name].drives]
    if len(drivers) > 1:
        raise ParameterError(f"{' and '.join(drivers)} would both drive: take one")
    return [MEMBERS[name] for name in names]


def _load(member: Member) -> type[SuiteNode]:
    kind: type[SuiteNode] = getattr(import_module(member.module), member.kind)
    return kind


def _addressed(words: Sequence[str], kinds: dict[str, type[SuiteNode]]) -> Iterator[str]:
    """Yield ROS arguments in which each parameter without a node is addressed to the nodes that have it.

    A node would otherwise warn of each parameter that is meant for another one.
    """
    previous = ""
    for word in words:
        name, assigned, value = word.partition(":=")
        if previous in _PARAMETER_FLAGS and assigned and ":" not in name:
            having = [node for node, kind in kinds.items() if any(each.name == name for each in kind.PARAMETERS)]
            first, *others = [f"{node}:{name}:={value}" for node in having] or [word]
            yield first
            for other in others:
                yield from (previous, other)
        else:
            yield word
        previous = word
