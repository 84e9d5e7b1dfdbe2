"""The drive of the README's moving picture by the real nodes: simulator, navigator, filter, watchdog, recorder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from ctrl_rl_navigation.cli.simulation import task_content
from ctrl_rl_navigation.maps import map_file
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from ctrl_rl_bringup.corridor.drive import running
from ctrl_rl_bringup.corridor.report import DriveReport, read_drive
from ctrl_rl_bringup.runner.prepare import new_run
from ctrl_rl_bringup.runner.stack import RAW, DriveConfig, NodeSpec, guards
from ctrl_rl_core import atomic_write, load_navigation_task

MAP = "warehouse"
START, GOAL = (7.5, 0.55, np.pi / 4), (3.7, 6.8)
TOLERANCE = 0.2
"""Distance from the goal at which it is reached [m]."""
_PERSON: dict[str, Any] = {
    "radius": "0.2 m",
    "track": {"points": ["(4.6, 5.5) m", "(0.45, 5.5) m"], "speed": "0.3 .. 0.3 m/s"},
}


def drive(folder: Path, speed: float) -> DriveReport:
    """Drive once, record everything in a new folder, and return what the bag says.

    Args:
        folder: Folder of the run, with the task's file beside it.
        speed: Simulation time per wall time.

    Raises:
        CtrlRlError: The folder exists, or the nodes do not come up.
    """
    content = task_content(map_file(MAP), START)
    x, y = GOAL
    content |= {
        "name": folder.name.replace("-", "_"),
        "goal": {"disc": {"centre": f"({x}, {y}) m", "radius": f"{TOLERANCE} m"}},
        "movers": [_PERSON],
        "episode": {"steps": 1500, "time_step": "0.1 s"},
    }
    file = (folder.parent / f"{content['name']}.yaml").resolve()
    file.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(file, yaml.safe_dump(content))
    options = DriveConfig(folder, task=str(file), speed=speed, safety_filter=True)
    new_run(options)
    navigator = NodeSpec("ctrl_rl_navigation", "navigator", {"use_sim_time": True}, (RAW,), remappings={"cmd_vel": RAW})
    with running(options, [navigator, *guards(options, load_navigation_task(options.task))], {}) as monitor:
        clicker = Node("clicker")
        goal = PoseStamped()
        goal.header.frame_id = "map"
        goal.pose.position.x, goal.pose.position.y = x, y
        clicker.create_publisher(PoseStamped, "goal_pose", 10).publish(goal)
        monitor.run()
        monitor.follow("driving")
        clicker.destroy_node()
    return read_drive(options.bag)
