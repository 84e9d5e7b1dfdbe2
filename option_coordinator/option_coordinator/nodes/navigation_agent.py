"""Node of a TurtleBot that executes the options of a delivery team, from odometry and scans to velocities."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from ctrl_rl_core.ros import Status, ok, warn
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan

from ctrl_rl_core import (
    LIDAR_PARAMETERS,
    LidarRobot,
    OdometryReader,
    Parameter,
    ParameterError,
    RobotNode,
    ScanGeometry,
    VelocityError,
    run_node,
)
from option_coordinator.navigation.planner import STAND, ReactivePlanner, scan_points
from option_coordinator.navigation.steering import Steering
from option_coordinator.nodes.option_agent import OptionAgent
from option_coordinator.protocol.option_client import ClientTimeouts
from option_coordinator.protocol.option_executor import AgentObservation, OptionResult
from option_coordinator.protocol.protocol_types import TeamId
from option_coordinator.teams.delivery import Delivery
from option_coordinator.teams.loading import load_team

_STAND = np.array(STAND)


class NavigationAgent(RobotNode):
    """Drives a robot between stations, executing one granted option after the other.

    Subscribes to scan and odom, publishes cmd_vel, all in the robot's namespace; requests options in the team's
    namespace. Drives around obstacles; stops without recent scan and odometry, and without an option.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *(replace(each, name="body") if each.kind == "robot" else each for each in LIDAR_PARAMETERS),
        Parameter("team", "delivery_team", "Team that comes with the package, or its .yaml file.", kind="path"),
        Parameter("robot", "", "Name of the robot in the team; empty for the name of its namespace."),
        Parameter("team_namespace", "/", "Namespace of the coordinator's topics.", kind="name"),
        Parameter(
            "memory",
            "",
            "SQLite file that keeps what the robot carries and has delivered, besides the coordinator; empty for none.",
            kind="path",
        ),
        Parameter("sensor_timeout", 1.0, "Age of the last scan or odometry that stops the robot [s].", 0.05, 10.0),
        Parameter("heartbeat", 0.1, "Period of heartbeats, and of repetitions of a request [s].", 0.01, 10.0),
        Parameter("patience", 2.0, "Time without an answer after which the safe option starts [s].", 0.05, 600.0),
    )
    robot: LidarRobot

    def __init__(self) -> None:
        super().__init__("navigation_agent")
        settings = self.settings
        team = load_team(settings["team"])
        name = settings["robot"] or self.get_namespace().strip("/")
        if name not in team.robots:
            raise ParameterError(f"parameter 'robot' is '{name}': team '{team.name}' has {', '.join(team.robots)}")
        self._names = team.option_names
        self._delivery, planner = Delivery(team, name), ReactivePlanner()
        self._steering = Steering(planner, list(team.robots).index(name))
        self.robot = robot = LidarRobot(self, "sensor_timeout")
        robot.set_limits((0.0, -planner.turn), (planner.speed, planner.turn))
        robot.on_scan, robot.on_odometry = self._keep, self._go_on
        self._read = OdometryReader(("x", "y", "theta"))
        self._pose: NDArray[np.float64] | None = None
        self._points: NDArray[np.float64] | None = None
        beat = settings["heartbeat"]
        patience = ClientTimeouts(heartbeat=beat, repeat=beat, waiting=settings["patience"])
        safe = self._names.index(team.safe_option)
        identity, space = TeamId(team.name, team.digest), settings["team_namespace"]
        memory = Path(settings["memory"]) if settings["memory"] else None
        self._agent = OptionAgent(self, name, self._names, self, safe, patience, space, identity, memory)

    def observe(self) -> AgentObservation:
        """Return the robot's observation and its legal options."""
        return self._delivery.see(np.zeros(3) if self._pose is None else self._pose)

    def resume(self, work: str) -> None:
        """Take over the work of an earlier process of this robot."""
        self._delivery.resume(work)
        self.get_logger().info(f"goes on with its work before the restart: {work}")

    def begin(self, option: int) -> None:
        """Start an option."""
        self.get_logger().info(f"begins '{self._names[option]}'")
        self._delivery.begin(option, self._now())

    def leave(self) -> OptionResult:
        """Stop the robot and end the option."""
        self._go(_STAND)
        return self._delivery.leave(self._now())

    def status(self) -> Status:
        """Report the running option."""
        level, message, sent = super().status()
        client, delivery = self._agent.client, self._delivery
        option = "none" if delivery.option is None else self._names[delivery.option]
        figures = {"option": option, "state": client.state.name.lower(), "delivered": delivery.delivered}
        figures |= {"carries": str(delivery.carries).lower(), "epoch": client.epoch, **client.counts, **sent}
        if self.robot.problem:
            return level, message, figures
        return warn(client.problem, **figures) if client.problem else ok(f"option '{option}'", **figures)

    def _go_on(self, _: Odometry, odometry: NDArray[np.float64]) -> None:
        """Advance the option from the robot's new pose."""
        first, self._pose = self._pose is None, self._read(odometry)
        if first:
            self._agent.start()
        self._drive()

    def _keep(self, _: LaserScan, ranges: NDArray[np.float32], scan: ScanGeometry) -> None:
        """Store the scan's points in the odometry frame."""
        if self._pose is not None and self.robot.safety.view is not None:
            self._points = scan_points(self._pose, ranges, scan, self.settings["lidar_x"])

    def _drive(self) -> None:
        """Advance the option."""
        option, place = self._delivery.option, self._delivery.place
        if self._pose is None or self._points is None or self.robot.stale_input():
            return
        if option is None:
            self._go(_STAND)
            return
        if place is not None and not self._steering.there(self._pose, place):
            attempts = self._steering.attempts
            command = self._steering.command(self._pose, self._points, place, self._now())
            if self._steering.attempts > attempts:
                self.get_logger().info(f"backs out on its way to '{self._names[option]}': it is blocked")
            self._go(np.array(command))
            return
        self._go(_STAND)
        result = self._delivery.at_place(self._now())
        if result is not None:
            self._agent.ended(result.reward, result.steps, self._delivery.over(option))

    def _go(self, command: NDArray[np.float64]) -> None:
        """Send a command, or stop if it is not safe."""
        try:
            self.robot.drive(command)
        except VelocityError as error:
            self.robot.halt(str(error))

    def _now(self) -> float:
        return 1e-9 * float(self.get_clock().now().nanoseconds)


def main() -> int:
    """Run the node."""
    return run_node(NavigationAgent)
