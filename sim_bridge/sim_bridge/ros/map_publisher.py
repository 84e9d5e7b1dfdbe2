"""The world of an episode for navigators and viewers: `map` as an occupancy grid, `walls` as markers."""

from __future__ import annotations

import math

from ctrl_rl_core.ros import LATCHED, to_stamp
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from visualization_msgs.msg import Marker, MarkerArray

from ctrl_rl_core import Box, OccupancyMap, Shape, World
from sim_bridge.engines.engine import WALL_HEIGHT
from sim_bridge.ros.frames import WORLD_FRAME
from sim_bridge.simulation.occupancy import draw_map
from sim_bridge.simulation.world import SimulatedWorld

_WALL = (0.55, 0.56, 0.60)
_OBSTACLE = (0.80, 0.50, 0.30)


class MapPublisher:
    """Publishes the map and walls of a world in the x-y plane whenever they change."""

    def __init__(self, node: Node, world: SimulatedWorld) -> None:
        self._world = world
        self._map = node.create_publisher(OccupancyGrid, "map", LATCHED)
        self._walls = node.create_publisher(MarkerArray, "walls", LATCHED)
        self._sent: World | None = None

    def publish(self, time: int) -> None:
        """Send the episode's map and walls at simulation time `time` [ns], unless they are unchanged."""
        world = self._world
        if world.geometry == self._sent:
            return
        self._sent = world.geometry
        self._map.publish(self._mapped().to_message(to_stamp(time), WORLD_FRAME))
        clear = Marker(action=Marker.DELETEALL)
        clear.header.frame_id = WORLD_FRAME
        walls = [_marker(shape, _WALL) for shape in world.geometry.walls]
        obstacles = [_marker(shape, _OBSTACLE) for shape in world.geometry.obstacles]
        markers = [clear, *walls, *obstacles]
        for number, marker in enumerate(markers):
            marker.id, marker.header.stamp = number, to_stamp(time)
        self._walls.publish(MarkerArray(markers=markers))

    def _mapped(self) -> OccupancyMap:
        """Return the task's map, without its obstacles, or the map of its arena or corridor."""
        world = self._world
        if world.task.map is not None:
            return world.task.map.map
        return draw_map(world.task, world.geometry)


def _marker(shape: Shape, colour: tuple[float, float, float]) -> Marker:
    out = Marker(ns="walls", action=Marker.ADD)
    out.header.frame_id = WORLD_FRAME
    out.pose.position.x, out.pose.position.y = shape.centre
    out.pose.position.z, out.scale.z = 0.5 * WALL_HEIGHT, WALL_HEIGHT
    if isinstance(shape, Box):
        out.type = Marker.CUBE
        out.scale.x, out.scale.y = shape.size
        out.pose.orientation.z, out.pose.orientation.w = math.sin(0.5 * shape.angle), math.cos(0.5 * shape.angle)
    else:
        out.type = Marker.CYLINDER
        out.scale.x = out.scale.y = 2.0 * shape.radius
    out.color.r, out.color.g, out.color.b = colour
    out.color.a = 1.0
    return out
