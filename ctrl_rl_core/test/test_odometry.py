"""States from odometry messages."""

import math
from types import SimpleNamespace as Message

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ctrl_rl_core import OdometryError, OdometryReader, read_odometry

ANGLE = st.floats(-3.1, 3.1)
SPEED = st.floats(-2.0, 2.0)


def odometry(position, quaternion, linear, angular):
    vector, q = (lambda v: Message(x=v[0], y=v[1], z=v[2])), quaternion
    pose = Message(position=vector(position), orientation=Message(x=q[0], y=q[1], z=q[2], w=q[3]))
    return Message(
        pose=Message(pose=pose), twist=Message(twist=Message(linear=vector(linear), angular=vector(angular)))
    )


@given(ANGLE, SPEED, SPEED)
def test_a_car_turns_about_z(theta, v, omega):
    message = odometry((1, 2, 0), (0, 0, math.sin(theta / 2), math.cos(theta / 2)), (v, 0, 0), (0, 0, omega))
    read = OdometryReader(("x", "y", "theta", "v", "omega"))
    np.testing.assert_allclose(read(read_odometry(message)), (1, 2, theta, v, omega), atol=1e-12)


@given(ANGLE, SPEED, SPEED, SPEED)
def test_a_quadrotor_turns_about_y_and_its_speeds_are_those_of_the_frame(psi, v_x, v_z, omega):
    c, s = math.cos(psi), math.sin(psi)
    body = (c * v_x - s * v_z, 0.0, s * v_x + c * v_z)
    message = odometry((1, 0, 3), (0, math.sin(psi / 2), 0, math.cos(psi / 2)), body, (0, omega, 0))
    read = OdometryReader(("x", "v_x", "z", "v_z", "psi", "omega"))
    np.testing.assert_allclose(read(read_odometry(message)), (1, v_x, 3, v_z, psi, omega), atol=1e-12)


def test_refuses_what_odometry_does_not_tell():
    with pytest.raises(OdometryError, match="odometry does not contain 'phi'"):
        OdometryReader(("x", "phi"))
