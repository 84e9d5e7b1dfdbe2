"""A TurtleBot that carries out the options of a delivery team: odometry and scan in, velocities out."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from ctrl_rl_core.odometry import OdometryReader
from ctrl_rl_core.parameters import Parameter, ParameterError
from ctrl_rl_core.ros import SENSOR, Status, ok, run_node
from ctrl_rl_core.velocity_node import VELOCITY_PARAMETERS, VelocityNode
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan

from option_coordinator.agent import OptionAgent
from option_coordinator.delivery import Delivery
from option_coordinator.robot_side import Earned, Patience, Seen
from option_coordinator.steering import STAND, Steering, scan_points
from option_coordinator.team_file import load_team

_STAND = np.array(STAND)


class NavigationAgent(VelocityNode):
    """Drives a robot between stations, one option after the other, as a coordinator grants them.

    Subscribes to scan and odom, publishes cmd_vel, all in the robot's namespace; asks for options in the team's. Drives
    around what stands in its way; stands still without recent scan and odometry, and without an option.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *VELOCITY_PARAMETERS,
        Parameter("team", "delivery_team", "Team that comes with the package, or its .yaml file.", kind="path"),
        Parameter("robot", "", "Its name in the team; empty for that of the namespace."),
        Parameter("team_namespace", "/", "Namespace of the coordinator's topics.", kind="name"),
        Parameter("lidar_x", -0.032, "Where the lidar sits, ahead of the robot's middle [m].", -1.0, 1.0),
        Parameter(
            "lidar_yaw", 0.0, "Direction of the scan's zero bearing in the robot's frame [rad].", -3.1416, 3.1416
        ),
        Parameter("sensor_timeout", 1.0, "Age of scan or odometry that stops the robot [s].", 0.05, 10.0),
        Parameter("heartbeat", 0.1, "Between two heartbeats, and repetitions of a request [s].", 0.01, 10.0),
        Parameter("patience", 2.0, "Without an answer, until the safe option begins [s].", 0.05, 600.0),
    )
    TIMEOUT = "sensor_timeout"

    def __init__(self) -> None:
        super().__init__("navigation_agent", needs=("scan", "odometry"))
        settings = self.settings
        team = load_team(settings["team"])
        name = settings["robot"] or self.get_namespace().strip("/")
        if name not in team.robots:
            raise ParameterError(f"parameter 'robot' is '{name}': team '{team.name}' has {', '.join(team.robots)}")
        self._names = team.option_names
        self._delivery, self._steering = Delivery(team, name), Steering()
        self.set_limits((0.0, -self._steering.turn), (self._steering.speed, self._steering.turn))
        self._read = OdometryReader(("x", "y", "theta"))
        self._pose: NDArray[np.float64] | None = None
        self._points: NDArray[np.float64] | None = None
        beat = settings["heartbeat"]
        patience = Patience(heartbeat=beat, repeat=beat, waiting=settings["patience"])
        safe = self._names.index(team.safe_option)
        self._agent = OptionAgent(self, name, self._names, self, safe, patience, settings["team_namespace"], team.name)
        self.create_subscription(Odometry, "odom", self._on_odometry, SENSOR)
        self.create_subscription(LaserScan, "scan", self._on_scan, SENSOR)

    def observe(self) -> Seen:
        """Return what the policy is told."""
        return self._delivery.see(np.zeros(3) if self._pose is None else self._pose)

    def begin(self, option: int) -> None:
        """Begin an option."""
        self.get_logger().info(f"begins '{self._names[option]}'")
        self._delivery.begin(option, self._now())

    def leave(self) -> Earned:
        """Leave an option as it is."""
        self.drive(_STAND)
        return self._delivery.leave(self._now())

    def status(self) -> Status:
        """Say what the robot does."""
        level, message, sent = super().status()
        side, delivery = self._agent.side, self._delivery
        option = "none" if delivery.option is None else self._names[delivery.option]
        figures = {"option": option, "state": side.state.name.lower(), "delivered": delivery.delivered}
        figures |= {"carries": str(delivery.carries).lower(), "epoch": side.epoch, **side.counts, **sent}
        return (level, message, figures) if self.problem else ok(f"option '{option}'", **figures)

    def _on_odometry(self, message: Odometry) -> None:
        first = self._pose is None
        self._pose = self._read(message)
        self.heard("odometry")
        self.robot_frame(message.child_frame_id)
        if first:
            self._agent.start()
        self._drive()

    def _on_scan(self, message: LaserScan) -> None:
        if self._pose is None:
            return
        ranges = np.frombuffer(message.ranges, np.float32)
        bearing = message.angle_min + self.settings["lidar_yaw"]
        self._points = scan_points(self._pose, ranges, bearing, message.angle_increment, self.settings["lidar_x"])
        self.heard("scan")

    def _drive(self) -> None:
        """Go on with the option."""
        option, place = self._delivery.option, self._delivery.place
        if self._pose is None or self._points is None or self.missing():
            return
        if option is None:
            self.drive(_STAND)
            return
        if place is not None and not self._steering.there(self._pose, place):
            self.drive(np.array(self._steering.command(self._pose, self._points, place)))
            return
        self.drive(_STAND)
        earned = self._delivery.at_place(self._now())
        if earned is not None:
            self._agent.ended(earned.reward, earned.steps, self._delivery.over(option))

    def _now(self) -> float:
        return 1e-9 * float(self.get_clock().now().nanoseconds)


def main() -> int:
    """Run the node."""
    return run_node(NavigationAgent)
