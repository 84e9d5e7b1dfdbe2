"""A made-up robot in an endless corridor between two circles: scans, odometry, and whatever cmd_vel says."""

import math
from contextlib import suppress

import numpy as np
import rclpy
from ctrl_rl_core.ros import SCAN_PUBLISHER, float32_array
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

from ctrl_rl_core import COMMAND

INNER, OUTER = 2.6, 3.4
RATE, SCAN_EVERY, BEAMS, LIDAR_X = 30, 3, 360, -0.032


class Robot(Node):
    """Drives as it is told."""

    def __init__(self) -> None:
        super().__init__("made_up_robot")
        self.pose, self.command, self.count = np.array([3.0, 0.0, 0.5 * math.pi]), (0.0, 0.0), 0
        self.random = np.random.default_rng(0)
        self.scan = self.create_publisher(LaserScan, "scan", SCAN_PUBLISHER)
        self.odom = self.create_publisher(Odometry, "odom", 10)
        self.create_subscription(TwistStamped, "cmd_vel", self.obey, COMMAND)
        self.create_timer(1.0 / RATE, self.tick)

    def obey(self, message: TwistStamped) -> None:
        """Take a command."""
        self.command = message.twist.linear.x, message.twist.angular.z

    def tick(self) -> None:
        """Move, and say where."""
        v, omega = self.command
        self.pose += np.array([v * math.cos(self.pose[2]), v * math.sin(self.pose[2]), omega]) / RATE
        odometry = Odometry()
        odometry.header.frame_id, odometry.child_frame_id = "odom", "base_footprint"
        odometry.header.stamp = self.get_clock().now().to_msg()
        odometry.pose.pose.position.x, odometry.pose.pose.position.y = map(float, self.pose[:2])
        odometry.pose.pose.orientation.z = math.sin(0.5 * self.pose[2])
        odometry.pose.pose.orientation.w = math.cos(0.5 * self.pose[2])
        odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = float(v), float(omega)
        self.odom.publish(odometry)
        self.count += 1
        if self.count % SCAN_EVERY == 0:
            self.look(odometry)

    def look(self, odometry: Odometry) -> None:
        """Send a scan."""
        x, y, yaw = self.pose
        place = np.array([x + LIDAR_X * math.cos(yaw), y + LIDAR_X * math.sin(yaw)])
        angles = yaw + 2.0 * np.pi * np.arange(BEAMS) / BEAMS
        along = np.cos(angles) * place[0] + np.sin(angles) * place[1]
        square = float(place @ place)
        outer = -along + np.sqrt(along**2 - square + OUTER**2)
        under = along**2 - square + INNER**2
        inner = np.where((under > 0.0) & (along < 0.0), -along - np.sqrt(np.maximum(under, 0.0)), np.inf)
        ranges = np.minimum(outer, inner) + self.random.normal(0.0, 0.01, BEAMS)
        message = LaserScan(angle_max=2.0 * math.pi * (BEAMS - 1) / BEAMS, angle_increment=2.0 * math.pi / BEAMS)
        message.header.stamp, message.header.frame_id = odometry.header.stamp, "base_scan"
        message.range_min, message.range_max, message.scan_time = 0.12, 3.5, SCAN_EVERY / RATE
        message.ranges = float32_array(np.where(ranges > 3.5, np.inf, np.maximum(ranges, 0.12)))
        self.scan.publish(message)


if __name__ == "__main__":
    rclpy.init()
    robot = Robot()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        while rclpy.ok():
            rclpy.spin_once(robot, timeout_sec=0.1)
    rclpy.try_shutdown()
