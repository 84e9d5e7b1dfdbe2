"""ros2 launch ctrl_rl_bringup demo.launch.py [seed:=0] [speed:=1.0] [policy:=...] [folder:=...].

The demo under ROS's own launch: simulator, controller and recorder, a monitor that lets them go and follows the
drive, then the report.
"""

import signal
from datetime import datetime
from pathlib import Path

from ctrl_rl_bringup.prepare import new_run, value_files
from ctrl_rl_bringup.stack import DriveOptions, NodeSpec, controller, recorder, simulator, value_nodes
from ctrl_rl_core.tasks import task_file
from koopman_lqr_controller.policy_file import find_policy
from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, EmitEvent, ExecuteProcess, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown, matches_action
from launch.events.process import SignalProcess
from launch.substitutions import FindExecutable, LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = {
    "task": ("curved_corridor", "task name or .yaml file"),
    "policy": ("curved_corridor_edmd", "policy name or .safetensors file"),
    "seed": ("0", "of start pose and noise"),
    "speed": ("1.0", "simulation time per wall time"),
    "gui": ("false", "show PyBullet's window"),
    "folder": ("", "new folder of the run; default runs/demo-<date>-<time>"),
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
    options = DriveOptions(
        folder=Path(value["folder"] or f"runs/demo-{datetime.now():%Y%m%d-%H%M%S}"),
        task=value["task"],
        policy=value["policy"],
        seed=int(value["seed"]),
        speed=float(value["speed"]),
        gui=value["gui"].lower() == "true",
    )
    files = {"task": task_file(options.task), "policy": find_policy(options.policy)}
    new_run(options)
    values = value_files(options)
    bag = _node(recorder(options, {**files, **values}))
    specs = [simulator(options), controller(options), *value_nodes(options, values)]
    others = [_node(spec) for spec in specs]
    awaited = ["--topics", ",".join(topic for spec in specs for topic in spec.publishes)]
    monitor = Node(package="ctrl_rl_bringup", executable="monitor", arguments=awaited, output="screen")
    command = [FindExecutable(name="ros2"), "run", "ctrl_rl_bringup", "report", str(options.folder)]
    report = ExecuteProcess(cmd=command, output="screen")
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
    return Node(package=spec.package, executable=spec.executable, parameters=[dict(spec.parameters)], output="screen")


def _interrupt(node: Node) -> SignalProcess:
    return SignalProcess(signal_number=signal.SIGINT, process_matcher=matches_action(node))
