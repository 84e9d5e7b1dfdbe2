"""A driver that knows one command: run as a process of its own, to be killed, frozen or fall silent."""

import time
from dataclasses import dataclass

import rclpy
from ctrl_rl_core.command import parse_options
from ctrl_rl_core.ros.node import COMMAND
from geometry_msgs.msg import TwistStamped
from rclpy.node import Node

SPEED = 0.125
RATE = 20.0


@dataclass
class Source:
    """Publish one velocity command again and again."""

    topic: str = "cmd_vel_raw"
    """Topic of the commands."""
    name: str = "source"
    """Name of the node."""
    commands: int = 0
    """Number of commands before it falls silent; 0 for no end."""


def main() -> None:
    options = parse_options("command_source", Source)
    rclpy.init()
    node = Node(options.name)
    publisher = node.create_publisher(TwistStamped, options.topic, COMMAND)
    message = TwistStamped()
    message.twist.linear.x = SPEED
    while publisher.get_subscription_count() == 0:
        time.sleep(0.02)
    sent = 0
    try:
        while True:
            if not options.commands or sent < options.commands:
                publisher.publish(message)
                sent += 1
            time.sleep(1.0 / RATE)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
