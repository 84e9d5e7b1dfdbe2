"""Planar robot models: outlines, mass and wheels, read from URDF files.

Joints and shapes in the URDF files may only be rotated by multiples of 90 degrees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from sim_bridge.engines.engine import URDF_FOLDER

Array = NDArray[np.float64]

_WHEELS = ("wheel_left_joint", "wheel_right_joint")


@dataclass(frozen=True)
class WheeledModel:
    """Constants of a differential drive's equations of motion.

    Attributes:
        mass: Mass of the whole robot [kg].
        inertia: Moment of inertia of the whole robot about the vertical axis through the axle's centre [kg m^2].
        wheel_inertia: Moment of inertia of one wheel about its axle [kg m^2].
        wheel_radius: Radius of the wheels [m].
        wheel_separation: Distance between the wheels [m].
    """

    mass: float
    inertia: float
    wheel_inertia: float
    wheel_radius: float
    wheel_separation: float

    @property
    def answers(self) -> tuple[float, float]:
        """Speed change per impulse of a wheel itself and of the other wheel [rad/s per N m s]."""
        # Kinetic energy in wheel speeds: coefficient `straight` for equal speeds, `turn` for opposite ones.
        straight = 0.5 * self.mass * self.wheel_radius**2 + self.wheel_inertia
        turn = 2.0 * self.inertia * (self.wheel_radius / self.wheel_separation) ** 2 + self.wheel_inertia
        return 0.5 * (1.0 / straight + 1.0 / turn), 0.5 * (1.0 / straight - 1.0 / turn)


class Outline(NamedTuple):
    """The collision shapes of a robot in a plane.

    Attributes:
        parts: Rounded rectangles along the robot's axes (parts, 7): centre (2) and half extents (2) [m], the
            radius [m] (a disc is a point with a radius), and the minimum and maximum coordinate across the plane [m].
        outer: Number of outer parts, listed first, which enclose all others in the plane.
    """

    parts: Array
    outer: int


@cache
def outline(urdf: str, plane: str) -> Outline:
    """Return the collision shapes of a robot in a plane, "xy" or "xz"."""
    tree = _tree(urdf)
    places = _places(tree)
    parts = [
        _part(collision, places[link.attrib["name"]], plane)
        for link in tree.findall("link")
        for collision in link.findall("collision")
    ]
    outer: list[Array] = []
    inner: list[Array] = []
    for part in sorted(parts, key=lambda part: -float(part[2:5].sum())):
        (inner if any(_holds(other, part) for other in outer) else outer).append(part)
    return Outline(np.array(outer + inner), len(outer))


def disc_outline(radius: float) -> Outline:
    """Return the outline of a disc of a radius [m] that is visible to all rays."""
    return Outline(np.array([[0.0, 0.0, 0.0, 0.0, radius, -np.inf, np.inf]]), 1)


def _part(collision: ET.Element, place: Array, plane: str) -> Array:
    first, second, across = (0, 1, 2) if plane == "xy" else (0, 2, 1)
    origin = collision.find("origin")
    centre = place + _numbers(origin, "xyz")
    sphere, cylinder, box = (collision.find(f"geometry/{kind}") for kind in ("sphere", "cylinder", "box"))
    radius, axis = 0.0, 2
    if box is not None:
        extent = 0.5 * _numbers(box, "size")
    elif sphere is not None:
        extent, radius = np.zeros(3), float(sphere.attrib["radius"])
    else:
        assert cylinder is not None, "a collision shape is a box, a cylinder or a sphere"
        thickness = float(cylinder.attrib["radius"])
        extent = np.array((thickness, thickness, 0.5 * float(cylinder.attrib["length"])))
    turns = np.round(_numbers(origin, "rpy") / (0.5 * math.pi)).astype(int) % 2
    for turn, (i, j) in zip(turns, ((1, 2), (0, 2), (0, 1)), strict=True):
        if turn:
            extent[[i, j]] = extent[[j, i]]
            axis = {i: j, j: i}.get(axis, axis)
    if cylinder is not None and axis == across:
        radius, extent = float(cylinder.attrib["radius"]), np.eye(3)[across] * extent
    depth = extent[across] + (radius if sphere is not None else 0.0)
    low, high = centre[across] - depth, centre[across] + depth
    return np.array((centre[first], centre[second], extent[first], extent[second], radius, low, high))


def _holds(outer: Array, inner: Array) -> bool:
    """Return whether a part lies within another one, a rectangle or a disc."""
    beside = np.abs(inner[:2] - outer[:2]) + inner[2:4]
    if outer[4] == 0.0:
        return bool((beside + inner[4] <= outer[2:4]).all())
    return bool(np.hypot(*beside) + inner[4] <= outer[4])


@cache
def wheeled_model(urdf: str) -> WheeledModel:
    """Return the constants of a differential drive from its URDF."""
    tree = _tree(urdf)
    places = _places(tree)
    links = {link.attrib["name"]: link for link in tree.findall("link")}
    joints = {joint.attrib["name"]: _attribute(joint, "child", "link") for joint in tree.findall("joint")}
    left, right = (joints[name] for name in _WHEELS)
    mass = inertia = 0.0
    for name, link in links.items():
        own = float(_attribute(link, "inertial/mass", "value"))
        place = places[name] + _numbers(link.find("inertial/origin"), "xyz")
        mass += own
        inertia += float(_attribute(link, "inertial/inertia", "izz")) + own * float(place[:2] @ place[:2])
    return WheeledModel(
        mass=mass,
        inertia=inertia,
        wheel_inertia=float(_attribute(links[left], "inertial/inertia", "iyy")),
        wheel_radius=float(_attribute(links[left], "collision/geometry/cylinder", "radius")),
        wheel_separation=float(places[left][1] - places[right][1]),
    )


def _places(tree: ET.Element) -> dict[str, Array]:
    """Return the position (3,) of each link in the root frame [m]."""
    joints = {_attribute(joint, "child", "link"): joint for joint in tree.findall("joint")}

    def place(name: str) -> Array:
        joint = joints.get(name)
        if joint is None:
            return np.zeros(3)
        return place(_attribute(joint, "parent", "link")) + _numbers(joint.find("origin"), "xyz")

    return {link.attrib["name"]: place(link.attrib["name"]) for link in tree.findall("link")}


@cache
def _tree(urdf: str) -> ET.Element:
    return ET.parse(URDF_FOLDER / urdf).getroot()


def _attribute(element: ET.Element, path: str, name: str) -> str:
    found = element.find(path)
    assert found is not None, f"{element.attrib}: has no {path}"
    return found.attrib[name]


def _numbers(element: ET.Element | None, name: str) -> Array:
    text = "0 0 0" if element is None else element.attrib.get(name, "0 0 0")
    return np.array([float(part) for part in text.split()])
