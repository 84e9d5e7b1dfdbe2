"""A drive whose controller dies, in a world whose robot, like a real one, holds its last command for ever."""

import signal
import time
from collections.abc import Callable

import pytest
import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node

from ctrl_rl_core import SENSOR

pytestmark = pytest.mark.usefixtures("_no_shared_memory")  # some are killed or frozen


@pytest.mark.fault
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_robot_stands_after_its_controller_died(run_node: Callable, number: int) -> None:
    rclpy.init()
    node, speeds = Node("onlooker"), list[float]()
    node.create_subscription(Odometry, "ground_truth", lambda said: speeds.append(said.twist.twist.linear.x), SENSOR)

    def until(condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + 300.0
        while not condition():
            assert time.monotonic() < deadline, f"{what}: {speeds[-5:]}"
            rclpy.spin_once(node, timeout_sec=0.02)

    try:
        run_node("sim_bridge", "bridge", "cmd_vel_timeout:=0.0", "seed:=5")
        run_node("ctrl_rl_core", "watchdog")
        controller = run_node("koopman_lqr_controller", "controller", remap=("cmd_vel:=cmd_vel_raw",))
        until(lambda: bool(speeds) and speeds[-1] > 0.05, "it never drove")
        controller.process.send_signal(number)
        until(lambda: max(abs(speed) for speed in speeds[-10:]) < 1e-3, "it drives on without a controller")
        if number == signal.SIGSTOP:
            controller.process.send_signal(signal.SIGCONT)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
