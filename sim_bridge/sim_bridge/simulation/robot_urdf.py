"""The URDF file of a robot: shipped, its own, or generated from its dimensions."""

from __future__ import annotations

import atexit
import math
import shutil
import tempfile
from functools import cache
from pathlib import Path

from ctrl_rl_core import Robot, Steering, Wheels
from sim_bridge.engines.engine import URDF_FOLDER
from sim_bridge.errors import SimulationError

_WHEEL_MASS = 0.05
"""Mass of a wheel as a fraction of the robot's mass."""
_RIM = 0.002
"""Width of the wheel rim on the floor [m]; a wide rim would roll on one of its edges."""
_CLEARANCE = 0.4
"""Height of the body above the floor, as a fraction of the wheel radius."""
_HEIGHT = 0.2
"""Body height of a robot without a lidar height [m]."""
_BELOW = 0.02
"""Height of the lidar's mirror above the body [m]."""


def urdf_of(robot: Robot) -> Path:
    """Return the URDF file of a robot; wheels turn about `wheel_left_joint` and `wheel_right_joint`.

    Raises:
        SimulationError: There is neither a file nor wheels to generate one from.
    """
    if robot.urdf:
        file = robot.urdf_file or URDF_FOLDER / robot.urdf
        if not file.is_file():
            raise SimulationError(
                f"robot '{robot.name}': there is no file {robot.urdf} beside its own, nor in the suite"
            )
        return file
    if robot.wheels is None:
        raise SimulationError(f"robot '{robot.name}' cannot be simulated: its file needs wheels and mass, or a urdf")
    file = _folder() / f"{robot.digest[:16]}.urdf"
    if not file.exists():
        file.write_text(make_urdf(robot), encoding="utf-8")
    return file


def make_urdf(robot: Robot) -> str:
    """Generate a URDF from a robot's dimensions: a round or rectangular body, two wheels, and two casters.

    A car has two steered front wheels in place of the casters.
    """
    assert robot.wheels is not None
    wheels, lidar = robot.wheels, robot.lidar
    parts_apart = 2 if robot.steering is None else 6  # wheels, and what carries those that are steered
    own, mass = _WHEEL_MASS * robot.mass, (1.0 - parts_apart * _WHEEL_MASS) * robot.mass
    low = _CLEARANCE * wheels.radius
    high = max(lidar.z - _BELOW, 1.5 * low) if lidar.z else _HEIGHT
    height, middle, base = high - low, 0.5 * (low + high), robot.base_height
    ahead = 0.0 if robot.steering is None else robot.steering.centre
    if robot.length:
        x, y, half = robot.length, robot.width, 0.5 * robot.length
        shape = f'<box size="{x:g} {y:g} {height:g}"/>'
        turns = mass / 12.0 * (x * x + y * y)
    else:
        half = robot.radius
        shape = f'<cylinder radius="{half:g}" length="{height:g}"/>'
        turns = 0.5 * mass * half * half
    tips = mass / 12.0 * (2.0 * half) ** 2
    spin = 0.5 * own * wheels.radius**2
    ball = 0.5 * low
    parts = [
        _link("base_footprint", 0.001, (1e-6, 1e-6, 1e-6)),
        _joint("base_joint", "fixed", "base_footprint", "base_link", (0.0, 0.0, base)),
        _link("base_link", mass, (tips, tips, turns), shape, middle - base, ahead=ahead),
        _joint("scan_joint", "fixed", "base_link", "base_scan", (lidar.x, lidar.y, lidar.z - base), lidar.yaw),
        _link("base_scan", 0.001, (1e-6, 1e-6, 1e-6)),
    ]
    rim = f'<cylinder radius="{wheels.radius:g}" length="{_RIM:g}"/>'
    for side, sign in (("left", 1.0), ("right", -1.0)):
        place = (0.0, sign * 0.5 * wheels.separation, wheels.radius - base)
        parts += [
            _joint(f"wheel_{side}_joint", "continuous", "base_link", f"wheel_{side}_link", place),
            _link(f"wheel_{side}_link", own, (0.5 * spin, spin, 0.5 * spin), rim, friction=1.0, roll=0.5 * math.pi),
        ]
    if robot.steering is not None:
        parts += _front_wheels(robot.steering, wheels, own, spin, rim, base)
    for side, sign in (("front", 1.0), ("back", -1.0)) if robot.steering is None else ():
        place = (sign * (0.8 * half - ball), 0.0, ball - base)
        parts += [
            _joint(f"ball_{side}_joint", "fixed", "base_link", f"ball_{side}_link", place),
            _link(f"ball_{side}_link", 0.001, (1e-7, 1e-7, 1e-7), f'<sphere radius="{ball:g}"/>', friction=0.0),
        ]
    return "\n".join(('<?xml version="1.0"?>', '<robot name="robot">', *parts, "</robot>\n"))


def _front_wheels(steering: Steering, wheels: Wheels, mass: float, spin: float, rim: str, base: float) -> list[str]:
    """Return the links and joints of two steered wheels of a mass [kg] and a moment of inertia [kg m^2]."""
    parts, knuckle = [], 0.4 * mass * wheels.radius**2
    for side, sign in (("left", 1.0), ("right", -1.0)):
        place = (steering.wheelbase, sign * 0.5 * wheels.separation, wheels.radius - base)
        parts += [
            _joint(f"steer_{side}_joint", "continuous", "base_link", f"steer_{side}_link", place, axis="0 0 1"),
            _link(f"steer_{side}_link", mass, (knuckle, knuckle, knuckle)),
            _joint(f"front_{side}_joint", "continuous", f"steer_{side}_link", f"front_{side}_link", (0.0, 0.0, 0.0)),
            _link(f"front_{side}_link", mass, (0.5 * spin, spin, 0.5 * spin), rim, friction=1.0, roll=0.5 * math.pi),
        ]
    return parts


@cache
def _folder() -> Path:
    """Return a temporary folder that is removed when this process ends."""
    folder = tempfile.mkdtemp(prefix="ctrl_rl-urdf-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    place: tuple[float, float, float],
    yaw: float = 0.0,
    axis: str = "0 1 0",
) -> str:
    origin = f'xyz="{place[0]:g} {place[1]:g} {place[2]:g}"' + (f' rpy="0 0 {yaw:.9g}"' if yaw else "")
    about = f'<axis xyz="{axis}"/>' if kind == "continuous" else ""
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}<origin {origin}/>{about}</joint>'


def _link(
    name: str,
    mass: float,
    inertia: tuple[float, float, float],
    shape: str = "",
    height: float = 0.0,
    friction: float | None = None,
    roll: float = 0.0,
    ahead: float = 0.0,
) -> str:
    place = f'<origin xyz="{ahead:g} 0 {height:g}" rpy="{roll:.9g} 0 0"/>'
    diagonal = " ".join(f'{axis}="{value:.6g}"' for axis, value in zip(("ixx", "iyy", "izz"), inertia, strict=True))
    out = f'<inertial><origin xyz="{ahead:g} 0 {height:g}"/><mass value="{mass:g}"/>'
    out += f'<inertia {diagonal} ixy="0" ixz="0" iyz="0"/></inertial>'
    if friction is not None:
        out = f'<contact><lateral_friction value="{friction:g}"/></contact>' + out
    if shape:
        out += "".join(f"<{kind}>{place}<geometry>{shape}</geometry></{kind}>" for kind in ("visual", "collision"))
    return f'<link name="{name}">{out}</link>'
