"""The command `view`: a robot in the browser, live or from a bag."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

from ctrl_rl_core.command import EXIT_USAGE
from ctrl_rl_core.policies import shipped_policies
from ctrl_rl_core.robots import DEFAULT_ROBOT
from ctrl_rl_navigation.maps import load_map

from ctrl_rl_bags import open_bag
from ctrl_rl_bringup.cli.running import own_arguments
from ctrl_rl_core import CommandError, OccupancyMap, Robot, find_robot, parse_options, run_command, run_node

if TYPE_CHECKING:
    from ctrl_rl_bringup.view.value_slice import ValueSlice

_LAST_PORT = 64_000
"""Last port to begin with; the next ones are tried if it is taken."""
INSTALL = "python -m pip install -r requirements/view.txt"
_EPILOG = """The page shows the robot, its map, scan, path and value, and the safety filter's set and escape. Whoever
gives the token on the page may click a goal, stop the robot and choose a policy; without --token a random one is
printed. ROS arguments may follow, as in: view --ros-args -r scan:=lidar_scan -p map_frame:=world. Parameters:
enable_stamped_cmd_vel (default true), map_frame (default map)."""


@dataclass(frozen=True)
class ViewOptions:
    """Show a robot in the browser, live or from a bag."""

    bag: Path | None = None
    """Bag to play instead of a live robot."""

    robot: str = DEFAULT_ROBOT
    """Robot: turtlebot3_burger, turtlebot2, turtlebot4, jackal, or a .yaml file."""

    namespace: str = ""
    """Namespace of the robot."""

    value: Path | None = None
    """Value file to show as a surface, at the robot's heading; by default the navigator's time to reach."""

    map: str = ""
    """Map to show where nobody publishes one: maze, warehouse, corridor, or map_server's .yaml file."""

    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 lets others on the network in, over an unencrypted connection."""

    port: int = 8080
    """Port to listen on; if it is taken, the next free one."""

    token: str = ""
    """Text of 8 letters or more that lets a visitor move the robot; by default a random one."""

    def check(self) -> None:
        """Check the values. Raises: CommandError: A value is out of range, or viser is not installed."""
        if find_spec("viser") is None:
            raise CommandError(f"needs the package 'viser', which is not installed: {INSTALL}")
        if not 0 <= self.port <= _LAST_PORT:
            raise CommandError(f"--port {self.port}: must be 0 to {_LAST_PORT}")
        if self.bag is not None and self.token:
            raise CommandError("--token: a bag has no robot to move")


def main() -> int:
    """Entry point of `ros2 run ctrl_rl_bringup view`."""
    options = parse_options("view", ViewOptions, own_arguments("view"), _EPILOG)
    if options.bag is not None:
        return run_command("view", lambda: _play(options), failure=EXIT_USAGE)
    return run_command("view", lambda: _show(options), failure=EXIT_USAGE)


def _prepared(options: ViewOptions) -> tuple[Robot, ValueSlice | None, OccupancyMap | None]:
    """Check the options, and read the files that they name."""
    options.check()
    from ctrl_rl_bringup.view.value_slice import ValueSlice

    value = None if options.value is None else ValueSlice(options.value)
    return find_robot(options.robot), value, load_map(options.map) if options.map else None


def _play(options: ViewOptions) -> int:
    robot, value, map_ = _prepared(options)
    assert options.bag is not None
    from ctrl_rl_bringup.view.page import Page, announce
    from ctrl_rl_bringup.view.recorded import Player, Recording

    with open_bag(options.bag) as bag:
        recording = Recording(bag, robot, options.namespace, value=value, map_=map_)
        page = Page(options.host, options.port, robot)
        announce(page, None, given=False)
        try:
            Player(recording, page).run(Event())
        except KeyboardInterrupt:
            return 0
        finally:
            page.close()
    return 0


def _show(options: ViewOptions) -> int:
    robot, value, map_ = _prepared(options)
    from ctrl_rl_bringup.view.access import Access
    from ctrl_rl_bringup.view.live import ViewNode
    from ctrl_rl_bringup.view.page import Page, announce

    access = Access(options.token)

    class View(ViewNode):
        """The node with the command's options: as a parameter the token would be seen by all, and be kept in bags."""

        def __init__(self) -> None:
            page = Page(options.host, options.port, robot, access, tuple(shipped_policies()))
            super().__init__(page, robot, value, map_)
            announce(page, access, bool(options.token))

    return run_node(View, [sys.argv[0], *_ros_arguments(options)])


def _ros_arguments(options: ViewOptions) -> list[str]:
    """Return the ROS arguments of the command line, with the namespace."""
    words = sys.argv[sys.argv.index("--ros-args") :] if "--ros-args" in sys.argv else []
    namespace = options.namespace.strip("/")
    return [*words, *(["--ros-args", "-r", f"__ns:=/{namespace}"] if namespace else [])]
