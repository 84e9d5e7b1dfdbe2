"""A run under ROS's launch: recorder, nodes, a monitor that starts them, then the report.

Only launch files import this module: launch needs an installed ROS.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, EmitEvent, ExecuteProcess, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown, matches_action
from launch.events.process import ProcessExited, SignalProcess
from launch.substitutions import FindExecutable, LaunchConfiguration
from launch_ros.actions import Node

from ctrl_rl_bringup.runner.domain import keep_domain, stay_local
from ctrl_rl_bringup.runner.stack import NodeSpec
from ctrl_rl_core import CtrlRlError

_PACKAGE = "ctrl_rl_bringup"
_OF_ALL = {
    "seed": ("0", "seed of starts, noise and draws"),
    "speed": ("1.0", "simulation time per wall time"),
    "gui": ("false", "show PyBullet's window"),
}
_READS: dict[str, Callable[[str], Any]] = {
    "seed": int,
    "speed": float,
    "gui": lambda text: {"true": True, "false": False}[text.lower()],
    "folder": Path,
}


class LaunchError(CtrlRlError):
    """An argument is invalid or a process failed, so that the launch ends with a non-zero code."""


@dataclass(frozen=True)
class Launch:
    """Nodes and commands of a launched run.

    Attributes:
        recorder: Recorder of all topics, which ends last.
        nodes: Nodes of the run besides the recorder.
        monitor: Executable of this package that ends when the run is over, with its arguments.
        report: Executable that reports on the bag, with its arguments.
    """

    recorder: NodeSpec
    nodes: Sequence[NodeSpec]
    monitor: Sequence[str]
    report: Sequence[str]


def description(
    name: str, arguments: Mapping[str, tuple[str, str]], prepare: Callable[..., Launch]
) -> LaunchDescription:
    """Return the description for `ros2 launch`.

    Args:
        name: Name of the run, used for its folder.
        arguments: Default and description of each argument besides seed, speed, gui and folder, by name.
        prepare: Called with the values of all arguments by name; makes the folder.
    """
    folder = ("", f"new folder of the run; default runs/{name}-<date>-<time>")
    known = {**arguments, **_OF_ALL, "folder": folder}

    def launch(context: LaunchContext) -> list[Action]:
        said = {key: LaunchConfiguration(key).perform(context) for key in known}
        said["folder"] = said["folder"] or f"runs/{name}-{datetime.now():%Y%m%d-%H%M%S}"
        values = {key: _read(key, text) for key, text in said.items()}
        stay_local()
        keep_domain()
        return _actions(prepare(**values))

    declared = [
        DeclareLaunchArgument(key, default_value=default, description=text) for key, (default, text) in known.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=launch)])


def _read(key: str, text: str) -> Any:
    try:
        return _READS.get(key, str)(text)
    except (ValueError, KeyError):
        raise LaunchError(f"{key}:={text}: not a value of this argument; see --show-args") from None


def _actions(run: Launch) -> list[Action]:
    bag, others = _node(run.recorder), [_node(spec) for spec in run.nodes]
    monitor = Node(package=_PACKAGE, executable=run.monitor[0], arguments=list(run.monitor[1:]), output="screen")
    report = ExecuteProcess(
        cmd=[FindExecutable(name="ros2"), "run", _PACKAGE, *run.report], output="screen", on_exit=_reported
    )
    ends = [EmitEvent(event=_interrupt(node)) for node in (*others, bag)]
    return [
        bag,
        *others,
        monitor,
        RegisterEventHandler(OnProcessExit(target_action=monitor, on_exit=ends)),
        RegisterEventHandler(OnProcessExit(target_action=bag, on_exit=[report])),
    ]


def _node(spec: NodeSpec) -> Node:
    return Node(
        package=spec.package,
        executable=spec.executable,
        namespace=spec.namespace,
        parameters=[dict(spec.parameters)],
        remappings=list(spec.remappings.items()),
        output="screen",
        on_exit=_ended,
    )


def _ended(event: ProcessExited, context: LaunchContext) -> None:
    if event.returncode and not context.is_shutdown:
        raise LaunchError(f"{event.process_name} ended with exit code {event.returncode}")


def _reported(event: ProcessExited, context: LaunchContext) -> EmitEvent:
    _ended(event, context)
    return EmitEvent(event=Shutdown())


def _interrupt(node: Node) -> SignalProcess:
    return SignalProcess(signal_number=signal.SIGINT, process_matcher=matches_action(node))
