"""A driver that sends one command, run as a separate process so that tests can kill, freeze or silence it."""

import argparse
import time

import rclpy
from geometry_msgs.msg import TwistStamped
from rclpy.node import Node

SPEED = 0.125
RATE = 20.0


def main() -> None:
    parser = argparse.ArgumentParser(description="Publish one velocity command again and again.")
    parser.add_argument("--topic", default="cmd_vel_raw", help="topic of the commands")
    parser.add_argument("--name", default="source", help="name of the node")
    parser.add_argument("--commands", type=int, default=0, help="commands before it falls silent; 0 for no end")
    options = parser.parse_args()
    rclpy.init()
    node = Node(options.name)
    publisher = node.create_publisher(TwistStamped, options.topic, 1)
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
