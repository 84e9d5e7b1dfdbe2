"""The pre-flight's node waits for the clock of a simulation, but not for ever."""

import pytest
import rclpy
from ctrl_rl_bringup.preflight.listener import Listener
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan


@pytest.mark.fault
@pytest.mark.parametrize("clock", [True, False])
def test_the_clock_of_a_simulation_is_waited_for_but_not_for_ever(clock: bool) -> None:
    rclpy.init()
    robot, listener, executor = Node("robot"), Listener(), SingleThreadedExecutor()
    scans, odometry = robot.create_publisher(LaserScan, "scan", 5), robot.create_publisher(Odometry, "odom", 5)
    clocks: list[Publisher] = []

    def send() -> None:
        scans.publish(LaserScan(ranges=[1.0] * 9))
        odometry.publish(Odometry())
        if clock and listener.heard.scans and listener.heard.odometry:  # its publisher is found last
            clocks[:] = clocks or [robot.create_publisher(Clock, "/clock", 5)]
            clocks[0].publish(Clock())

    robot.create_timer(0.05, send)
    for node in (robot, listener):
        executor.add_node(node)
    try:
        listener.wait(executor, 60.0 if clock else 2.0)
        assert listener.heard.simulated == clock
    finally:
        executor.shutdown()
        for node in (robot, listener):
            node.destroy_node()
        rclpy.shutdown()
