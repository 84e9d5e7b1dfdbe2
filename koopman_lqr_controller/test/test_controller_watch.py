"""Further checks of the controller: wall time while the simulated clock is paused, and other command publishers."""

import time
from collections.abc import Callable

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from robot_side import PATIENCE_S, Robot, ask, corridor
from rosgraph_msgs.msg import Clock

from ctrl_rl_core import COMMAND


@pytest.mark.fault
@pytest.mark.parametrize("blind", ["scan", "odometry"])
def test_a_blind_robot_stands_though_the_simulated_clock_does_too(robot: Robot, run_node: Callable, blind: str) -> None:
    controller = run_node("koopman_lqr_controller", "controller", "use_sim_time:=true", "wall_timeout:=1.0")
    clock = robot.node.create_publisher(Clock, "/clock", 1)
    robot.wait_for_controller()
    clock.publish(Clock())
    assert ask(robot, corridor(0.1), 1_000).twist.linear.x > 0.0
    reason = f"stopping: no recent {blind}"
    before = controller.output.count(reason)
    deadline = time.monotonic() + PATIENCE_S
    count = 1_000
    while robot.commands[-1].twist.linear.x != 0.0:
        assert time.monotonic() < deadline, "it drives on"
        if blind == "odometry":
            count += 1
            robot.send(corridor(0.1), count, odometry=False)
        else:
            robot.odom.publish(Odometry())
        robot.spin(0.1)
    assert robot.spin(PATIENCE_S, lambda: controller.output.count(reason) > before), "the log follows the zero velocity"
    assert ask(robot, corridor(0.1), 10**6).twist.linear.x > 0.0, "it drives again once it sees"


@pytest.mark.fault
def test_it_names_whoever_else_drives_the_robot(robot: Robot, run_node: Callable) -> None:
    said: list[DiagnosticStatus] = []
    robot.node.create_subscription(DiagnosticArray, "diagnostics", lambda message: said.extend(message.status), 10)
    controller = run_node("koopman_lqr_controller", "controller", "scan_timeout:=5.0")
    robot.wait_for_controller()
    ask(robot, corridor(0.1), 1_000)
    rival = robot.node.create_publisher(TwistStamped, "cmd_vel", COMMAND)
    rival.publish(TwistStamped())
    assert robot.spin(PATIENCE_S, lambda: any("/robot publishes on /cmd_vel too" in each.message for each in said))
    warned = next(each for each in said if "publishes on" in each.message)
    assert warned.level == DiagnosticStatus.WARN
    assert {value.key: value.value for value in warned.values}["other publishers"] == "/robot"
    controller.wait_for("/robot publishes on /cmd_vel too: the robot follows the latest command of any")
    robot.node.destroy_publisher(rival)
    said.clear()
    assert robot.spin(PATIENCE_S, lambda: bool(said) and "publishes" not in said[-1].message)
    assert np.isfinite(robot.commands[-1].twist.linear.x)
