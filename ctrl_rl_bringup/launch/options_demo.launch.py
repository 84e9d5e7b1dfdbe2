"""ros2 launch ctrl_rl_bringup options_demo.launch.py [team:=...] [policy:=spread] [seed:=0] [speed:=1.0] [folder:=...].

A team of TurtleBots under the coordinator, with ROS's own launch: simulator, coordinator, robots and recorder, a
monitor that lets them go and follows the work, then the report.
"""

import signal
from datetime import datetime
from pathlib import Path

from ctrl_rl_bringup.options_stack import TeamOptions, agents, coordinator, team_of, team_simulator
from ctrl_rl_bringup.prepare import new_run
from ctrl_rl_bringup.stack import NodeSpec, recorder
from ctrl_rl_core.tasks import task_file
from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, EmitEvent, ExecuteProcess, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown, matches_action
from launch.events.process import SignalProcess
from launch.substitutions import FindExecutable, LaunchConfiguration
from launch_ros.actions import Node
from option_coordinator.team_file import team_file

ARGUMENTS = {
    "team": ("delivery_team", "team name or .yaml file"),
    "room": (TeamOptions(Path()).room, "navigation task or .yaml file"),
    "policy": ("spread", "'spread' or 'uniform', which were not learnt, or a .safetensors file"),
    "seed": ("0", "of starts, noise and draws"),
    "speed": ("1.0", "simulation time per wall time"),
    "gui": ("false", "show PyBullet's window"),
    "folder": ("", "new folder of the run; default runs/options-<date>-<time>"),
}


def generate_launch_description() -> LaunchDescription:
    """Return the demo."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_stack)])


def _stack(context: LaunchContext) -> list[Action]:
    value = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    options = TeamOptions(
        folder=Path(value["folder"] or f"runs/options-{datetime.now():%Y%m%d-%H%M%S}"),
        team=value["team"],
        room=value["room"],
        policy=value["policy"],
        seed=int(value["seed"]),
        speed=float(value["speed"]),
        gui=value["gui"].lower() == "true",
    )
    team = team_of(options)
    new_run(options.drive)
    bag = _node(recorder(options.drive, {"task": task_file(options.room), "team": team_file(options.team)}))
    others = [_node(spec) for spec in (*agents(options, team), coordinator(options), team_simulator(options, team))]
    monitor = Node(
        package="ctrl_rl_bringup", executable="options_monitor", arguments=["--team", options.team], output="screen"
    )
    again = ["options_report", str(options.folder), "--team", options.team, "--room", options.room]
    report = ExecuteProcess(cmd=[FindExecutable(name="ros2"), "run", "ctrl_rl_bringup", *again], output="screen")
    ends = [EmitEvent(event=_interrupt(node)) for node in (*others, bag)]
    return [
        bag,
        *others,
        monitor,
        RegisterEventHandler(OnProcessExit(target_action=monitor, on_exit=ends)),
        RegisterEventHandler(OnProcessExit(target_action=bag, on_exit=[report])),
        RegisterEventHandler(OnProcessExit(target_action=report, on_exit=[EmitEvent(event=Shutdown())])),
    ]


def _node(spec: NodeSpec) -> Node:
    return Node(
        package=spec.package,
        executable=spec.executable,
        namespace=spec.namespace,
        parameters=[dict(spec.parameters)],
        output="screen",
    )


def _interrupt(node: Node) -> SignalProcess:
    return SignalProcess(signal_number=signal.SIGINT, process_matcher=matches_action(node))
