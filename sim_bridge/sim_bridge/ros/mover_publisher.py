"""The moving obstacles of a world: `movers` as data, `mover_markers` for viewers."""

from __future__ import annotations

import math

from ctrl_rl_core.ros import ODOM_PUBLISHER, to_stamp
from geometry_msgs.msg import Point, Vector3
from rclpy.node import Node
from visualization_msgs.msg import Marker, MarkerArray

from ctrl_rl_msgs.msg import Mover, Movers
from sim_bridge.engines.engine import SLAB_DEPTH, WALL_HEIGHT
from sim_bridge.ros.frames import WORLD_FRAME, CountedPublisher
from sim_bridge.simulation.world import SimulatedWorld

_COLOUR = (0.85, 0.20, 0.25)


class MoverPublisher:
    """Publishes the movers of a world.

    Attributes:
        publishers: One per topic.
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
        """Send positions and velocities at simulation time `time` [ns]."""
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
