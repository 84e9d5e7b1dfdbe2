"""Publishes the world of an episode for navigators and viewers: map, walls and moving obstacles."""

from __future__ import annotations

import math

from ctrl_rl_core.ros import LATCHED, ODOM_PUBLISHER, to_stamp
from geometry_msgs.msg import Point, Vector3
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from visualization_msgs.msg import Marker, MarkerArray

from ctrl_rl_core import Box, OccupancyMap, Shape, World
from ctrl_rl_msgs.msg import Mover, Movers
from sim_bridge.engines.engine import SLAB_DEPTH, WALL_HEIGHT
from sim_bridge.ros.frames import WORLD_FRAME, CountedPublisher
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
        """Publish the episode's map and walls at simulation time `time` [ns] if they have changed."""
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
        """Return the task's own map, without its obstacles, or else a map of its arena or corridor."""
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


_COLOUR = (0.85, 0.20, 0.25)


class MoverPublisher:
    """Publishes the movers of a world.

    Attributes:
        publishers: Publishers, one per topic.
    """

    def __init__(self, node: Node, world: SimulatedWorld) -> None:
        self._world = world
        self._movers = CountedPublisher(node, Movers, "movers", ODOM_PUBLISHER)
        self._markers = CountedPublisher(node, MarkerArray, "mover_markers", ODOM_PUBLISHER)
        self.publishers = (self._movers, self._markers)
        radii = world.movers().radii.tolist()
        self._message = Movers(movers=[Mover(id=number, radius=radius) for number, radius in enumerate(radii)])
        self._message.header.frame_id = WORLD_FRAME
        self._shown = MarkerArray(markers=[self._marker(number, radius) for number, radius in enumerate(radii)])

    def publish(self, time: int) -> None:
        """Publish positions and velocities at simulation time `time` [ns]."""
        states, stamp = self._world.movers(), to_stamp(time)
        self._message.header.stamp = stamp
        rows = zip(states.positions.tolist(), states.velocities.tolist(), strict=True)
        for (place, speed), mover, marker in zip(rows, self._message.movers, self._shown.markers, strict=True):
            mover.position = marker.pose.position = self._point(*place)
            mover.velocity = self._vector(*speed)
            marker.header.stamp = stamp
        self._movers.publish(self._message)
        self._markers.publish(self._shown)

    def _point(self, first: float, second: float) -> Point:
        if self._world.plane == "xy":
            return Point(x=first, y=second, z=0.5 * WALL_HEIGHT)
        return Point(x=first, z=second)

    def _vector(self, first: float, second: float) -> Vector3:
        return Vector3(x=first, y=second) if self._world.plane == "xy" else Vector3(x=first, z=second)

    def _marker(self, number: int, radius: float) -> Marker:
        out = Marker(ns="movers", id=number, type=Marker.CYLINDER, action=Marker.ADD)
        out.header.frame_id = WORLD_FRAME
        out.scale.x = out.scale.y = 2.0 * radius
        out.scale.z = WALL_HEIGHT
        if self._world.plane == "xz":
            out.scale.z = SLAB_DEPTH
            out.pose.orientation.x = out.pose.orientation.w = math.sqrt(0.5)
        out.color.r, out.color.g, out.color.b = _COLOUR
        out.color.a = 1.0
        return out
