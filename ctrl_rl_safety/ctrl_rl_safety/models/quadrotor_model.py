"""The planar quadrotor of a task as modelled by the guard: constants of thesis Eq. 3.10, limits and size."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from ctrl_rl_core import NavigationTask
from ctrl_rl_safety.errors import SafetyError

LENGTH, HEIGHT = 0.8, 0.25
"""Side lengths of the body in its plane [m], as in `planar_quadrotor.urdf` of `sim_bridge`."""
_STATES = ("x", "v_x", "z", "v_z", "psi", "omega")


@dataclass(frozen=True)
class QuadrotorModel:
    """A planar quadrotor (x, v_x, z, v_z, psi, omega) with the thrusts T_1 and T_2 (thesis Eq. 3.10).

    Attributes:
        mass: Total mass [kg].
        gravity: Acceleration of free fall [m/s^2].
        drag: Drag of the speed C_v [N s/m].
        spin_drag: Drag of the pitch rate C_psi [N m s/rad].
        inertia: Moment of inertia I_yy [kg m^2].
        arm: Distance l of the rotors from the centre [m].
        least: Minimum thrust of each pair of rotors [N].
        most: Maximum thrust of each pair of rotors [N].
        tilt_limit: Pitch beyond which the quadrotor counts as crashed [rad].
        length: Length of the body [m].
        height: Height of the body [m].
        disturbance: Bound of the acceleration's deviation from the model, by wind or another mass [m/s^2].

    Raises:
        SafetyError: A number is not finite or is out of range, or the quadrotor cannot hover, climb and sink.
    """

    mass: float
    gravity: float
    drag: float
    spin_drag: float
    inertia: float
    arm: float
    least: float
    most: float
    tilt_limit: float
    length: float = LENGTH
    height: float = HEIGHT
    disturbance: float = 0.0

    def __post_init__(self) -> None:
        may_be_zero = {"drag", "spin_drag", "least", "disturbance"}
        for each in fields(self):
            number = getattr(self, each.name)
            if not (math.isfinite(number) and (number > 0.0 or (number == 0.0 and each.name in may_be_zero))):
                raise SafetyError(f"quadrotor: {each.name} is {number:g}: give a finite number in its range")
        if self.tilt_limit > 0.5 * math.pi:
            raise SafetyError(f"quadrotor: a tilt limit of {self.tilt_limit:g} rad: give at most pi / 2")
        weight = self.mass * self.gravity
        if not 2.0 * self.least < weight < 2.0 * self.most:
            raise SafetyError(
                f"quadrotor: its thrusts are {2.0 * self.least:g} to {2.0 * self.most:g} N together, so that it cannot "
                f"hover with a weight of {weight:g} N: the guard needs the limits of its rotors, not of a policy"
            )


def quadrotor_of(task: NavigationTask) -> QuadrotorModel:
    """Return the quadrotor of a task, with the thrusts of its system, since a policy's may be fewer.

    Raises:
        SafetyError: The task has no planar quadrotor or no tilt limit, or its model cannot hover.
    """
    system = task.system.build()
    if system.state_names != _STATES or task.robot.body != "planar_quadrotor":
        raise SafetyError(f"task '{task.name}' has no planar quadrotor")
    if task.robot.tilt_limit is None:
        raise SafetyError(f"task '{task.name}' lacks `tilt_limit` of its robot, which the guard keeps")
    least, most = system.control_bounds
    mass, gravity, drag, spin_drag, inertia, arm = (
        float(system.parameters[name]) for name in ("m", "g", "C_v", "C_psi", "I_yy", "l")
    )
    limits = float(least.max()), float(most.min()), float(task.robot.tilt_limit)
    return QuadrotorModel(mass, gravity, drag, spin_drag, inertia, arm, *limits)
