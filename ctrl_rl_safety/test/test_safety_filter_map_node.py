"""The filter as a real node with a map: mapped obstacles are static; until the map arrives, all may move."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from ctrl_rl_core.ros import LATCHED
from nav_msgs.msg import OccupancyGrid
from room import HALF, Room

from ctrl_rl_msgs.msg import SafetyStatus
from ctrl_rl_safety import ROBOTS

RADIUS = ROBOTS["turtlebot3_burger"].radius
CELL = 0.05


@pytest.fixture
def room() -> Iterator[Room]:
    rclpy.init()
    out = Room()
    yield out
    out.node.destroy_node()
    rclpy.try_shutdown()


def room_map(frame: str) -> OccupancyGrid:
    """Return the map of the room, with walls one cell thick."""
    half = math.ceil(HALF / CELL) + 2
    middles = CELL * (np.arange(-half, half) + 0.5)
    away = np.maximum(np.abs(middles), np.abs(middles)[:, None])
    out: Any = OccupancyGrid()
    out.header.frame_id, out.info.resolution = frame, CELL
    out.info.width = out.info.height = 2 * half
    out.info.origin.position.x = out.info.origin.position.y = -half * CELL
    out.info.origin.orientation.w = 1.0
    out.data.frombytes(np.where(np.abs(away - HALF) <= CELL, 100, 0).astype(np.int8).tobytes())
    return out


def test_with_its_map_a_robot_comes_nearer_to_walls_that_else_might_move(
    run_shared_node: Callable[..., Any], room: Room
) -> None:
    run_shared_node(
        "ctrl_rl_safety",
        "safety_filter",
        "lidar_x:=0.0",
        "unblock_after:=0.0",
        "use_map:=true",
        "mover_speed:=0.6",
        "mover_acceleration:=20.0",
        "mover_size:=0.0",
    )
    publisher = room.node.create_publisher(OccupancyGrid, "map", LATCHED)
    room.raw = (0.22, 0.0)
    room.until_told(SafetyStatus.CORRECTED)
    publisher.publish(room_map("somewhere"))  # in a frame that it does not know
    room.until(lambda: room.command[0] == pytest.approx(0.0, abs=0.01))
    assert room.gap > RADIUS + 0.2
    publisher.publish(room_map("map"))
    room.until(lambda: room.gap < RADIUS + 0.15)
    room.until(lambda: room.command[0] == pytest.approx(0.0, abs=0.01))
    assert room.gap > RADIUS
