"""Drives a robot to and fro and round for half a minute, as the guide to `identify` asks: starts, stops, both turns."""

import time

import rclpy
from geometry_msgs.msg import TwistStamped

from ctrl_rl_core import COMMAND

_PERIOD_S = 0.05
_LEG_S = 1.5
_LEGS = ((0.5, 0.0), (0.0, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5), (0.4, 0.4), (-0.4, -0.4), (0.0, 0.0))


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("drive_about")
    publisher = node.create_publisher(TwistStamped, "cmd_vel", COMMAND)
    for speed, turn in (*_LEGS, *_LEGS, *_LEGS[:4]):
        end = time.monotonic() + _LEG_S
        while time.monotonic() < end:
            message = TwistStamped()
            message.header.stamp = node.get_clock().now().to_msg()
            message.twist.linear.x, message.twist.angular.z = speed, turn
            publisher.publish(message)
            time.sleep(_PERIOD_S)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
