"""Motion within a time step: limits per axis, and limits coupled by two wheels."""

import numpy as np
import pytest
from ctrl_rl_safety.models.growth import unnoticed_speed
from ctrl_rl_safety.models.motion import motion_of, next_speeds
from hypothesis import given, settings
from hypothesis import strategies as st

from ctrl_rl_core import find_robot
from ctrl_rl_safety import RobotModel

pytest.importorskip("sim_bridge")
from sim_bridge.engines import wheel_speeds, wheeled_model

STEP = 0.02
speeds = st.floats(-2.0, 2.0)
rates = st.floats(-6.0, 6.0)


@pytest.mark.parametrize("body", ["turtlebot2", "turtlebot3_burger", "jackal"])
@settings(deadline=None)
@given(v=speeds, omega=rates, v_c=speeds, omega_c=rates, weakness=st.floats(2.0, 100.0))
def test_limits_that_wheels_share_are_those_of_an_engines_motors(
    body: str, v: float, omega: float, v_c: float, omega_c: float, weakness: float
) -> None:
    wheels, torque = wheeled_model(f"{body}.urdf"), find_robot(body).wheels.torque / weakness
    (own, shared), radius, track = wheels.answers, wheels.wheel_radius, wheels.wheel_separation
    acceleration, turn_acceleration = radius * (own + shared) * torque, 2.0 * radius / track * (own - shared) * torque
    model = RobotModel(
        "wheels", 0.2, 2.0, 2.0, 6.0, acceleration, acceleration, turn_acceleration, track=wheels.wheel_separation
    )
    to_wheels = np.array(((1.0, -0.5 * track), (1.0, 0.5 * track))) / radius
    turned = to_wheels @ (v, omega)
    wheel_speeds(turned, to_wheels @ (v_c, omega_c), own, shared, torque * STEP)
    expected = np.linalg.solve(to_wheels, turned)
    if v * expected[0] < 0.0:
        expected[0] = 0.0
    np.testing.assert_allclose(next_speeds(v, omega, v_c, omega_c, motion_of(model, STEP)), expected, atol=1e-9)


def test_limits_by_axis_do_not_know_each_other() -> None:
    model = RobotModel("axes", 0.2, 2.0, 2.0, 6.0, 1.0, 2.0, 3.0)
    v, omega = next_speeds(0.5, 0.0, 0.0, 6.0, motion_of(model, STEP))
    assert (v, omega) == pytest.approx((0.5 - 2.0 * STEP, 3.0 * STEP))


def farthest(v: float, accelerations: np.ndarray, step: float) -> float:
    """Return the largest past distance of a mover of the present speed, by its accelerations backwards in time (n,)."""
    before = v - step * np.cumsum(accelerations)
    return float(np.abs(np.cumsum(step * (before + 0.5 * step * accelerations))).max())


@settings(deadline=None)
@given(
    distance=st.floats(0.01, 0.3), span=st.floats(0.1, 3.0), acceleration=st.floats(0.1, 3.0), seed=st.integers(0, 999)
)
def test_nobody_who_stays_unnoticed_is_faster_than_the_bound(
    distance: float, span: float, acceleration: float, seed: int
) -> None:
    bound, count = unnoticed_speed(distance, span, acceleration), 1000
    from_rest = acceleration * np.clip(bound / acceleration * count / span - np.arange(count), 0.0, 1.0)
    assert farthest(bound, from_rest, span / count) <= 1.01 * distance
    other = acceleration * np.repeat(np.random.default_rng(seed).uniform(-1.0, 1.0, 10), count // 10)
    assert farthest(1.02 * bound, other, span / count) > distance
