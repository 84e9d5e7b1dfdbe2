"""The model of a robot for viewers: its URDF, the frames of its links, and its wheel angles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from ctrl_rl_core import NavigationTask
from sim_bridge.errors import SimulationError
from sim_bridge.ros.frames import Frames, transform
from sim_bridge.simulation.robot_urdf import urdf_of

WHEELS = ("wheel_left_joint", "wheel_right_joint")


@dataclass(frozen=True)
class _Joint:
    kind: str
    parent: str
    child: str
    place: tuple[float, float, float]
    yaw: float


class RobotModel:
    """Messages that describe the model of one robot.

    Attributes:
        description: The URDF file.
        fixed: Transforms that never change.
    """

    def __init__(self, frames: Frames, task: NavigationTask) -> None:
        self._frames = frames
        robot = task.robot.robot
        if robot is None:
            raise SimulationError(
                f"task '{task.name}': the bridge does not support a body 'model': simulate it in Python"
            )
        text = urdf_of(robot).read_text(encoding="utf-8")
        self.description = String(data=text)
        self._joints = {joint.get("name", ""): _read(joint) for joint in ET.fromstring(text).iter("joint")}
        self.fixed = [self._transform(joint) for joint in self._joints.values() if joint.kind == "fixed"]
        if frames.plane == "xz":
            # The lidar rotates about its own z, which points along -y of the body: bearings run from x to z.
            scan = transform(frames.base, frames.scan, (0.0, 0.0, 0.0))
            scan.transform.rotation.x = scan.transform.rotation.w = math.sqrt(0.5)
            self.fixed = [scan]
        self._state = JointState(name=list(WHEELS))

    def joint_state(self, stamp: Time, angles: tuple[float, float]) -> JointState:
        """Return the angles of the left and right wheel [rad] as a JointState message."""
        self._state.header.stamp = stamp
        self._state.position = list(angles)
        return self._state

    def wheels(self, stamp: Time, angles: tuple[float, float]) -> list[TransformStamped]:
        """Return the transforms of the wheels."""
        out = []
        for name, angle in zip(WHEELS, angles, strict=True):
            wheel = self._transform(self._joints[name])
            wheel.header.stamp = stamp
            wheel.transform.rotation.y, wheel.transform.rotation.w = math.sin(0.5 * angle), math.cos(0.5 * angle)
            out.append(wheel)
        return out

    def _transform(self, joint: _Joint) -> TransformStamped:
        out = transform(self._frames.topic(joint.parent), self._frames.topic(joint.child), joint.place)
        out.transform.rotation.z, out.transform.rotation.w = math.sin(0.5 * joint.yaw), math.cos(0.5 * joint.yaw)
        return out


def _read(joint: ET.Element) -> _Joint:
    """Return the transform of a joint rotated only about the vertical axis, such as a lidar's."""
    links = {part.tag: part.get("link", "") for part in joint}
    origin = joint.find("origin")
    x, y, z = (0.0, 0.0, 0.0) if origin is None else map(float, origin.get("xyz", "0 0 0").split())
    turn = (0.0, 0.0, 0.0) if origin is None else tuple(map(float, origin.get("rpy", "0 0 0").split()))
    return _Joint(joint.get("type", ""), links["parent"], links["child"], (x, y, z), turn[2])
