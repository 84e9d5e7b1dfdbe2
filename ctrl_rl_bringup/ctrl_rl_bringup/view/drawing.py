"""Draws a `Scene` by viser: only what has changed since the last time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import trimesh
import viser

from ctrl_rl_bringup.view.colours import BODY, DANGER, EDGE, GOAL, RAW, SCAN, SENT, WALL, Colour
from ctrl_rl_bringup.view.scene import Array, Pose, Scene
from ctrl_rl_bringup.view.shapes import (
    centre_of,
    floor_of,
    funnel_of,
    picture_of,
    quaternion,
    segments_of,
    walls_of,
)
from ctrl_rl_core import Robot

_TALL, _FLAT = 0.3, 0.12
"""Height of walls, and of a robot without a lidar [m]."""
_DEPTH, _DEEPEST = 0.1, 1.5
"""Depth of the value's funnel below the floor, as a share of its width and at most [m]."""
_ON_FLOOR, _PATH, _LINE = 0.005, 0.02, 0.03
"""Heights of the pictures on the floor and of the lines above it, and their width [m]."""
_NEAR = 10.0
"""Size of the square around a robot without a map that is looked at first [m]."""
_SECOND = 1.5
"""Length of a command's arrow: the way of so many seconds [s]."""
_FASTEST = 2.0
"""Longest arrow [m]."""


class Drawing:
    """The scene's parts on a server.

    Args:
        server: Server of the page.
        robot: Robot, from whose file its model is made.
    """

    def __init__(self, server: viser.ViserServer, robot: Robot) -> None:
        self._server, self._scene, self._robot = server, server.scene, robot
        self._shown: dict[str, Any] = {}
        self._looked = False
        self._frame = self._scene.add_frame("/robot", show_axes=False, visible=False)
        self._add_robot()
        none = np.zeros((0, 3), np.float32)
        self._scan = self._scene.add_point_cloud("/scan", none, SCAN, point_size=0.03, precision="float32")
        arrows, colours = np.zeros((2, 2, 3), np.float32), np.array((RAW, SENT), np.uint8)
        self._arrows = self._scene.add_arrows(
            "/robot/commands", arrows, colours, shaft_radius=0.012, head_radius=0.03, head_length=0.06
        )

    def update(self, scene: Scene) -> None:
        """Draw what has changed."""
        if self._is_new("map", scene.map):
            self._draw_map(scene)
        if self._is_new("value", scene.value):
            self._draw_value(scene)
        if self._is_new("pose", scene.pose):
            self._draw_pose(scene.pose)
        if self._is_new("scan", scene.scan):
            self._scan.points = _raised(scene.scan, self._robot.lidar.z or _FLAT)
        if self._is_new("path", scene.path):
            self._draw_line("/path", scene.path, EDGE, _LINE)
        if self._is_new("safe_set", scene.safe_set):
            self._draw_set(scene)
        if self._is_new("escape", scene.escape):
            escape = scene.escape
            points, colour = (np.zeros((0, 2)), DANGER) if escape is None else (escape.points, _bytes(escape.colour))
            self._draw_line("/escape", points, colour, 2.0 * _LINE)
        if self._is_new("goal", scene.goal):
            self._draw_goal(scene.goal)
        if self._is_new("commands", (scene.raw, scene.sent)):
            self._arrows.points = np.array((_arrow(scene.raw, 0.32), _arrow(scene.sent, 0.26)), np.float32)

    def _is_new(self, name: str, value: Any) -> bool:
        """Return whether a value has changed since it was drawn: a tuple by content, an array by identity."""
        before = self._shown.get(name)
        if before is value or (isinstance(value, tuple) and before == value):
            return False
        self._shown[name] = value
        return True

    def _add_robot(self) -> None:
        """Add the body, the wheels and the lidar of the robot's file; the nose shows where it heads."""
        robot, scene = self._robot, self._scene
        top = robot.lidar.z or _FLAT
        low = min(robot.base_height + 0.02, 0.5 * top)
        middle, tall = 0.5 * (low + top), 0.9 * top - low
        if robot.length > 0.0:
            ahead = 0.0 if robot.steering is None else robot.steering.centre
            scene.add_box(
                "/robot/body", BODY, (robot.length, robot.width, tall), position=(ahead, 0.0, middle), opacity=0.9
            )
            front = ahead + 0.5 * robot.length
        else:
            front = robot.through_gaps
            scene.add_cylinder("/robot/body", front, tall, BODY, position=(0.0, 0.0, middle), opacity=0.9)
        scene.add_box("/robot/nose", EDGE, (0.5 * front, 0.02, 0.01), position=(0.75 * front, 0.0, 0.95 * top))
        if robot.lidar.z > 0.0:
            scene.add_cylinder(
                "/robot/lidar", 0.035, 0.04, EDGE, position=(robot.lidar.x, robot.lidar.y, robot.lidar.z)
            )
        for side in (-1.0, 1.0) if robot.wheels is not None else ():
            assert robot.wheels is not None
            place = 0.0, 0.5 * side * robot.wheels.separation, robot.wheels.radius
            lying = math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0
            scene.add_cylinder(f"/robot/wheel_{side:+.0f}", robot.wheels.radius, 0.02, EDGE, position=place, wxyz=lying)

    def _draw_pose(self, pose: Pose | None) -> None:
        self._frame.visible = pose is not None
        if pose is not None:
            self._frame.position, self._frame.wxyz = (pose[0], pose[1], 0.0), quaternion(pose[2])
            if not self._looked:  # until there is a map
                self._look_at(pose[0], pose[1], _NEAR)

    def _draw_map(self, scene: Scene) -> None:
        self._remove("/map", "/walls")
        if scene.map is None:
            return
        map_, (width, height) = scene.map, scene.map.size
        x, y = centre_of(map_.cells.shape, map_.resolution, map_.origin)
        self._scene.add_image(
            "/map", floor_of(map_), width, height, position=(x, y, 0.0), wxyz=quaternion(map_.origin[2])
        )
        if (walls := walls_of(map_, _TALL)) is not None:
            self._scene.add_mesh_simple("/walls", *walls, color=WALL, flat_shading=True)
        self._look_at(x, y, max(width, height))

    def _look_at(self, x: float, y: float, size: float) -> None:
        """Let new visitors, and those who are here, see a square of a size [m] from the south."""
        self._looked = True
        position, target = (x, y - 0.5 * size, 0.65 * size), (x, y, 0.0)
        camera = self._server.initial_camera
        camera.position, camera.look_at = position, target
        for client in self._server.get_clients().values():
            client.camera.position, client.camera.look_at = position, target

    def _draw_value(self, scene: Scene) -> None:
        value = scene.value
        wide = 0.0 if value is None else value.cell * max(value.heights.shape)
        found = None if value is None else funnel_of(value, min(_DEPTH * wide, _DEEPEST))
        if found is None:
            self._remove("/value")
            return
        (vertices, faces), colours = found
        mesh = trimesh.Trimesh(vertices, faces, vertex_colors=colours, process=False)
        self._scene.add_mesh_trimesh("/value", mesh, position=(0.0, 0.0, -_LINE))

    def _draw_set(self, scene: Scene) -> None:
        grid = scene.safe_set
        if grid is None:
            self._remove("/safe_set")
            return
        rows, columns = grid.percent.shape
        x, y = centre_of(grid.percent.shape, grid.cell, grid.origin)
        self._scene.add_image(
            "/safe_set",
            picture_of(grid),
            columns * grid.cell,
            rows * grid.cell,
            position=(x, y, _ON_FLOOR),
            wxyz=quaternion(grid.origin[2]),
        )

    def _draw_line(self, name: str, points: Array, colour: Colour, width: float) -> None:
        if len(points) < 2:
            self._remove(name)
        else:
            self._scene.add_line_segments(name, segments_of(points, _PATH), colour, thickness=width)

    def _draw_goal(self, goal: tuple[float, float] | None) -> None:
        if goal is None:
            self._remove("/goal")
        else:
            self._scene.add_cylinder("/goal", 0.1, 0.6, GOAL, position=(*goal, 0.3), opacity=0.5)

    def _remove(self, *names: str) -> None:
        for name in names:
            if self._scene.get_handle_by_name(name) is not None:
                self._scene.remove_by_name(name)


def _raised(points: Array, height: float) -> Any:
    return np.column_stack((points, np.full(len(points), height))).astype(np.float32)


def _bytes(colour: tuple[float, float, float]) -> Colour:
    red, green, blue = (int(255 * min(max(part, 0.0), 1.0)) if math.isfinite(part) else 0 for part in colour)
    return red, green, blue


def _arrow(command: tuple[float, float] | None, height: float) -> Array:
    """Return the chord (2, 3) of a command's arc in the robot's frame, at a height [m]."""
    if command is None:
        return np.zeros((2, 3))
    speed, turn = command
    half = min(max(0.5 * turn * _SECOND, -math.pi), math.pi)
    way = min(max(speed * _SECOND, -_FASTEST), _FASTEST)
    chord = way * (math.sin(half) / half if abs(half) > 1e-6 else 1.0)
    return np.array(((0.0, 0.0, height), (chord * math.cos(half), chord * math.sin(half), height)))
