"""The filter's node with a car: the same node, topics and parameters as of other robots."""

from collections.abc import Callable
from typing import Any

import pytest
import rclpy
from room import Room

from ctrl_rl_msgs.msg import SafetyStatus
from ctrl_rl_safety import CarModel, find_vehicle


@pytest.mark.usefixtures("_no_shared_memory")
def test_a_car_stops_before_a_wall_and_backs_off(run_node: Callable[..., Any]) -> None:
    model = find_vehicle("race_car")
    assert isinstance(model, CarModel)
    nose = model.centre + 0.5 * model.length
    rclpy.init()
    room = Room()
    try:
        node = run_node("ctrl_rl_safety", "safety_filter", "robot:=race_car", "lidar_x:=0.0", "scan_timeout:=1.0")
        room.raw = (0.3, 0.05)
        passed = room.until_told(SafetyStatus.PASSED)
        assert (passed.speed, passed.turn_rate) == pytest.approx(room.raw)
        room.until_told(SafetyStatus.ESCAPING)
        room.until(lambda: room.command[0] == pytest.approx(0.0, abs=0.01))
        assert nose < room.gap < nose + 0.2
        room.raw = (-0.2, 0.0)
        room.until(lambda: room.command == pytest.approx(room.raw))
        assert "callback failed" not in node.output
    finally:
        room.node.destroy_node()
        rclpy.try_shutdown()
