"""MuJoCo models of worlds: walls and obstacles of a plane, and robots from their URDF files."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

import mujoco

from ctrl_rl_core import Box, Disc, Shape
from sim_bridge.engines.engine import (
    GRAVITY,
    MOVER_MASS,
    SLAB_DEPTH,
    URDF_FOLDER,
    WALL_HEIGHT,
    FlyingRobot,
    WheeledRobot,
    placed,
)

WHEELS = ("wheel_left_joint", "wheel_right_joint")
FRONT = ("front_left_joint", "front_right_joint")
STEERING = ("steer_left_joint", "steer_right_joint")
PLANAR_JOINTS = ("x", "z", "psi")
MOTOR = "_motor"
"""Suffix of a motor's joint, after the wheel's name."""
ROOT = "base_footprint"

_HULL_FRICTION = 0.25  # friction between hull and wall, equivalent to PyBullet's default of 0.5 for both surfaces
_MOVERS = 2  # contact bit of movers
_SHAFT = 1e6  # moment of inertia of a motor's shaft [kg m^2], large enough that nothing slows it down
_LIGHT = 1e-9  # mass [kg] and moment of inertia [kg m^2] of a rail; MuJoCo requires them to be positive


def prefix(robot: int) -> str:
    """Return the name prefix of a robot's parts."""
    return f"{robot}/"


def build_model(
    rate: int,
    plane: str,
    shapes: Sequence[Shape],
    robots: Sequence[WheeledRobot | FlyingRobot],
    movers: Sequence[float] = (),
) -> mujoco.MjModel:
    """Build the model of a world; robot poses are part of the state.

    Args:
        rate: Physics steps per second [Hz].
        plane: Plane of the world, "xy" or "xz".
        shapes: Walls and obstacles; shape i is the geom `fixed_geom(plane, i)`.
        robots: Robots; the names of robot i's parts begin with `prefix(i)`.
        movers: Radii of the movers [m].
    """
    spec = mujoco.MjSpec()
    spec.compiler.fusestatic = True
    option = spec.option
    option.timestep = 1.0 / rate
    option.gravity = (0.0, 0.0, -GRAVITY if plane == "xy" else 0.0)
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER  # MuJoCo's implicit integrators make the wheels hop
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    if plane == "xy":
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1.0, 1.0, 1.0), friction=(0.0, 0.0, 0.0))
    for shape in shapes:
        _add_fixed(spec, shape, plane)
    for number, robot in enumerate(robots):
        child = _wheeled(robot, rate) if isinstance(robot, WheeledRobot) else _flying(robot)
        spec.attach(child, prefix=prefix(number), frame=spec.worldbody.add_frame())
    for number, radius in enumerate(movers):
        _add_mover(spec, number, radius, plane)
    return spec.compile()


def mover_name(mover: int, axis: int | None = None) -> str:
    """Return the name of a mover's geom, or of its joint along the first or second axis of the plane."""
    return f"mover{mover}" if axis is None else f"mover{mover}_{axis}"


def fixed_geom(plane: str, shape: int) -> int:
    """Return the geom of a wall or obstacle."""
    return shape + (plane == "xy")


def _add_fixed(spec: mujoco.MjSpec, shape: Shape, plane: str) -> None:
    _add_shape(spec.worldbody, shape, plane)


def _add_mover(spec: mujoco.MjSpec, number: int, radius: float, plane: str) -> None:
    """Add a heavy cylinder on two slide joints, without contacts to walls and other movers."""
    body = spec.worldbody.add_body(name=mover_name(number), mass=MOVER_MASS, inertia=(1.0, 1.0, 1.0))
    for axis, direction in enumerate(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0) if plane == "xy" else (0.0, 0.0, 1.0))):
        body.add_joint(name=mover_name(number, axis), type=mujoco.mjtJoint.mjJNT_SLIDE, axis=direction)
    geom = _add_shape(body, Disc((0.0, 0.0), radius), plane)
    geom.name, geom.contype, geom.conaffinity, geom.mass = mover_name(number), _MOVERS, 0, 0.0


def _add_shape(body: mujoco.MjsBody, shape: Shape, plane: str) -> mujoco.MjsGeom:
    extent, position, (x, y, z, w) = placed(shape, plane)
    kind, size = mujoco.mjtGeom.mjGEOM_BOX, extent
    if not isinstance(shape, Box):
        height = WALL_HEIGHT if plane == "xy" else SLAB_DEPTH
        kind, size = mujoco.mjtGeom.mjGEOM_CYLINDER, [shape.radius, 0.5 * height, 0.0]
    return body.add_geom(
        type=kind,
        size=size,
        pos=position,
        quat=(w, x, y, z),
        friction=(_HULL_FRICTION, 0.0, 0.0),
    )


def _wheeled(robot: WheeledRobot, rate: int) -> mujoco.MjSpec:
    spec = _load(robot.urdf)
    spec.body(ROOT).add_freejoint(name=ROOT)
    for name in wheel_joints(robot):
        for rim in spec.joint(name).parent.geoms:
            rim.priority = 1  # over the floor: use the wheel's friction, which is set when the robot is placed
    for name in WHEELS:
        _add_motor(spec, name, robot.torque, rate)
    for steering, front in zip(STEERING, FRONT, strict=True) if robot.steered else ():
        spec.joint(steering).armature = _SHAFT
        spec.add_exclude(bodyname1=ROOT, bodyname2=spec.joint(front).parent.name)  # the wheel lies inside the body
    return spec


def wheel_joints(robot: WheeledRobot) -> tuple[str, ...]:
    """Return the joints of all wheels on the floor."""
    return (*WHEELS, *FRONT) if robot.steered else WHEELS


def _add_motor(spec: mujoco.MjSpec, wheel: str, torque: float, rate: int) -> None:
    """Add a motor: a heavy shaft with a given speed, and a clutch to the wheel that slips at the torque [N m].

    A velocity actuator is unsuitable: MuJoCo ignores it when it solves for contact forces, so wheels would creep.
    """
    shaft = spec.worldbody.add_body(name=wheel + MOTOR, mass=1.0, inertia=(1.0, 1.0, 1.0))
    shaft.add_joint(name=wheel + MOTOR, axis=(0.0, 1.0, 0.0), armature=_SHAFT)
    clutch = spec.add_tendon(
        name=wheel,
        frictionloss=torque,
        solref_friction=(-1.0, -float(rate)),  # stiffness and damping: the wheel follows the shaft within a step
        solimp_friction=(0.9999, 0.9999, 0.001, 0.5, 2.0),  # maximum stiffness
    )
    clutch.wrap_joint(wheel, 1.0)
    clutch.wrap_joint(wheel + MOTOR, -1.0)


def _flying(robot: FlyingRobot) -> mujoco.MjSpec:
    spec = _load(robot.urdf)
    for name in PLANAR_JOINTS:
        joint = spec.joint(name)
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        body, last = joint.parent, name == PLANAR_JOINTS[-1]
        body.mass = robot.mass if last else _LIGHT
        body.fullinertia = (*(robot.inertia if last else _LIGHT,) * 3, 0.0, 0.0, 0.0)
    return spec


def _load(urdf: str) -> mujoco.MjSpec:
    """Load a robot from its URDF file, with the friction that MuJoCo's parser ignores."""
    file = URDF_FOLDER / urdf
    spec = mujoco.MjSpec.from_file(str(file))
    slippery = {
        link.get("name")
        for link in ET.parse(file).iter("link")
        if (friction := link.find("contact/lateral_friction")) is not None and float(friction.get("value", "1")) == 0.0
    }
    for body in spec.bodies:
        for geom in body.geoms:
            smooth = body.name in slippery
            geom.friction = (0.0 if smooth else _HULL_FRICTION, 0.0, 0.0)
            geom.group = 0
            geom.conaffinity = 1 | _MOVERS
            geom.condim = 1 if smooth else 3
            geom.priority = 2 if smooth else 0
    return spec
