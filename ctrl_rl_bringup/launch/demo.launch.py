"""ros2 launch ctrl_rl_bringup demo.launch.py [seed:=0] [speed:=1.0] [policy:=...] [folder:=...]: the demo."""

from pathlib import Path

from ctrl_rl_bringup.runner.launching import Launch, description
from ctrl_rl_bringup.runner.prepare import new_run, value_files
from ctrl_rl_bringup.runner.stack import controller, recorder, simulator, value_nodes, watchdog
from launch import LaunchDescription

from ctrl_rl_bringup import DriveConfig
from ctrl_rl_core import task_file
from koopman_lqr_controller import find_policy

ARGUMENTS = {
    "task": (DriveConfig.task, "task name or .yaml file"),
    "policy": (DriveConfig.policy, "policy name or .safetensors file"),
}


def generate_launch_description() -> LaunchDescription:
    """Return the launch description of the demo."""
    return description("demo", ARGUMENTS, _prepare)


def _prepare(folder: Path, task: str, policy: str, seed: int, speed: float, gui: bool) -> Launch:
    options = DriveConfig(folder, task, policy, seed, speed, gui=gui)
    files = {"task": task_file(task), "policy": find_policy(policy)}
    new_run(options)
    values = value_files(options)
    nodes = [simulator(options), controller(options), watchdog(options.speed), *value_nodes(options, values)]
    awaited = ",".join(topic for node in nodes for topic in node.publishes)
    return Launch(
        recorder=recorder(options, {**files, **values}),
        nodes=nodes,
        monitor=("monitor", "--topics", awaited),
        report=("report", str(folder)),
    )
