import math
from dataclasses import replace

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from ctrl_rl_core import SYSTEM_MODELS, System, SystemModelError, make_system

SYSTEMS = {name: make_system(name) for name in SYSTEM_MODELS}


@st.composite
def arguments(draw, system: System, rows: int = 3):
    """Return states, controls and disturbances within the model's bounds, away from the Euler angles' singularity."""

    def box(quantities, margin):
        columns = []
        for quantity in quantities:
            lower, upper = max(quantity.lower, -margin), min(quantity.upper, margin)
            columns.append(draw(st.lists(st.floats(lower, upper), min_size=rows, max_size=rows)))
        return np.array(columns).T

    d = np.array(
        draw(st.lists(st.floats(-2, 2), min_size=rows * len(system.states), max_size=rows * len(system.states)))
    )
    x = box(system.states, 10.0)
    if system.name == "quadrotor_rotation":
        x[:, 1] *= 0.9
    return x, box(system.controls, 20.0), d.reshape(rows, -1)


def casadi_function(system: System) -> casadi.Function:
    x, u, d = (casadi.MX.sym(name, size) for name, size in zip("xud", sizes(system), strict=True))
    rates = system.dynamics(x, u, d, math=casadi)
    return casadi.Function("f", [x, u, d], [rates, casadi.jacobian(rates, x), casadi.jacobian(rates, u)])


def sizes(system: System) -> tuple[int, int, int]:
    return len(system.states), len(system.controls), len(system.states)


@pytest.mark.parametrize("name", SYSTEMS)
def test_numpy_numba_and_casadi_agree(name):
    system = SYSTEMS[name]
    compiled, symbolic = system.numba_dynamics(), casadi_function(system)

    @settings(max_examples=40, deadline=None, derandomize=True)
    @given(arguments(system))
    def check(case):
        x, u, d = case
        rates = system.dynamics(x, u, d)
        assert rates.shape == x.shape
        for row in range(len(x)):
            by_numba = compiled(tuple(x[row]), tuple(u[row]), tuple(d[row]))
            by_casadi = np.array(symbolic(x[row], u[row], d[row])[0]).ravel()
            np.testing.assert_allclose(by_numba, rates[row], rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(by_casadi, rates[row], rtol=1e-12, atol=1e-12)
        batched = system.dynamics(casadi.DM(x.T), casadi.DM(u.T), casadi.DM(d.T), math=casadi)
        np.testing.assert_allclose(np.array(batched).T, rates, rtol=1e-12, atol=1e-12)

    check()


@pytest.mark.parametrize("name", SYSTEMS)
def test_jacobians_by_casadi_match_finite_differences_and_f_is_affine_in_u_and_d(name):
    system = SYSTEMS[name]
    symbolic = casadi_function(system)
    h = 1e-5

    @settings(max_examples=15, deadline=None, derandomize=True)
    @given(arguments(system, rows=1))
    def check(case):
        x, u, d = (part[0] for part in case)
        rates, by_x, by_u = (np.array(part) for part in symbolic(x, u, d))
        for i in range(len(x)):
            e = h * np.eye(len(x))[i]
            slope = (system.dynamics(x + e, u, d) - system.dynamics(x - e, u, d)) / (2 * h)
            np.testing.assert_allclose(slope, by_x[:, i], rtol=1e-6, atol=1e-5)
        zero_control = system.dynamics(x, np.zeros_like(u), d)
        np.testing.assert_allclose(zero_control + by_u @ u, rates.ravel(), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(system.dynamics(x, u) + d, rates.ravel(), rtol=1e-9, atol=1e-9)

    check()


def test_numba_dynamics_runs_inside_a_jitted_loop_and_is_shared():
    quadrotor = make_system("planar_quadrotor")
    f = quadrotor.numba_dynamics()
    assert make_system("planar_quadrotor").numba_dynamics() is f
    assert make_system("planar_quadrotor", parameters={"m": 2}).numba_dynamics() is not f

    @njit
    def climb_rates(thrusts):
        total = 0.0
        for thrust in thrusts:
            total += f((0.0,) * 6, (thrust, thrust), (0.0,) * 6)[3]
        return total

    assert climb_rates(np.array([1.0, 2.0])) == pytest.approx(2 * (1 + 2) / 1.25 - 2 * 9.81)


def roll_out(system: System, x, u, seconds: float, dt: float = 0.01):
    for _ in range(round(seconds / dt)):
        x = system.step(x, u, dt=dt)
    return x


@pytest.mark.parametrize(("v", "omega"), [(1.0, 0.5), (2.0, -0.7)])
def test_dubins_car_drives_a_circle(v, omega):
    t, radius = 3.0, v / omega
    expected = [radius * np.sin(omega * t), radius * (1 - np.cos(omega * t)), omega * t]
    np.testing.assert_allclose(roll_out(SYSTEMS["dubins_car"], np.zeros(3), [v, omega], t), expected, atol=1e-9)


def test_extended_dubins_car_accelerates_straight_ahead():
    x = roll_out(SYSTEMS["extended_dubins_car"], np.array([0.0, 0.0, np.pi / 2, 0.5, 0.0]), [1.0, 0.0], 2.0)
    np.testing.assert_allclose(x, [0, 0.5 * 2 + 0.5 * 2**2, np.pi / 2, 2.5, 0], atol=1e-9)


def test_bicycle_drives_the_circle_of_its_steering_angle():
    car = make_system("bicycle", parameters={"wheelbase": 0.4})
    radius, v, t = 0.4 / np.tan(0.3), 1.5, 2.0
    angle = v * t / radius
    x = roll_out(car, np.array([0, 0, 0, 0.3]), [v, 0.0], t)
    np.testing.assert_allclose(x, [radius * np.sin(angle), radius * (1 - np.cos(angle)), angle, 0.3], atol=1e-8)


def test_planar_quadrotor_falls_to_its_terminal_speed():
    p = SYSTEMS["planar_quadrotor"].parameters
    t, tau = 4.0, p["m"] / p["C_v"]
    x = roll_out(SYSTEMS["planar_quadrotor"], np.zeros(6), [0, 0], t)
    v = -p["g"] * tau * (1 - np.exp(-t / tau))
    np.testing.assert_allclose(x, [0, 0, -p["g"] * tau * t - v * tau, v, 0, 0], atol=1e-8)


def test_planar_quadrotor_hovers():
    thrust = 1.25 * 9.81 / 2
    hover = np.array([1.0, 0, 2.0, 0, 0, 0])
    assert SYSTEMS["planar_quadrotor"].dynamics(hover, [thrust, thrust]) == pytest.approx(np.zeros(6), abs=1e-12)


def test_torque_free_rotation_keeps_energy_and_momentum():
    system = make_system("quadrotor_rotation", parameters={"I_xx": 0.02, "I_yy": 0.03, "I_zz": 0.05})
    inertia = np.array([0.02, 0.03, 0.05])

    def momentum(x):  # in the inertial frame: R_z(psi) R_y(theta) R_x(phi) I omega
        phi, theta, psi = x[:3]
        c, s = np.cos, np.sin
        r_x = np.array([[1, 0, 0], [0, c(phi), -s(phi)], [0, s(phi), c(phi)]])
        r_y = np.array([[c(theta), 0, s(theta)], [0, 1, 0], [-s(theta), 0, c(theta)]])
        r_z = np.array([[c(psi), -s(psi), 0], [s(psi), c(psi), 0], [0, 0, 1]])
        return r_z @ r_y @ r_x @ (inertia * x[3:])

    start = np.array([0.1, -0.2, 0.3, 0.5, -0.4, 0.6])
    end = roll_out(system, start, np.zeros(3), 1.5)
    assert inertia @ end[3:] ** 2 == pytest.approx(inertia @ start[3:] ** 2, rel=1e-9)
    np.testing.assert_allclose(momentum(end), momentum(start), atol=1e-9)


def test_point_mass_drifts_with_the_wind():
    x = SYSTEMS["point_mass"].step([0, 0, 1], [1, 2, 3], [0.5, 0, 0], dt=2.0)
    np.testing.assert_allclose(x, [3, 4, 7])


def test_step_is_the_same_in_casadi():
    system = SYSTEMS["planar_quadrotor"]
    x, u = np.array([0.0, 1, 2, -1, 0.3, 0.2]), np.array([7.0, 5.0])
    by_casadi = system.step(casadi.DM(x), casadi.DM(u), dt=0.05, math=casadi)
    np.testing.assert_allclose(np.array(by_casadi).ravel(), system.step(x, u, dt=0.05), rtol=1e-13)


def test_one_control_broadcasts_over_many_states():
    rates = SYSTEMS["dubins_car"].dynamics(np.zeros((4, 5, 3)), [1.0, 0.5])
    assert rates.shape == (4, 5, 3)
    np.testing.assert_allclose(rates[2, 3], [1, 0, 0.5])


@given(st.floats(-1e6, 1e6))
def test_wrap_keeps_the_direction(angle):
    wrapped = SYSTEMS["dubins_car"].wrap([[1e3, 2e3, angle]])[0]
    assert -math.pi <= wrapped[2] < math.pi
    assert math.cos(wrapped[2] - angle) == pytest.approx(1, abs=1e-12)
    assert list(wrapped[:2]) == [1e3, 2e3]


def test_wrap_at_the_ends_of_the_period():
    wrap = SYSTEMS["dubins_car"].wrap
    assert wrap([0, 0, math.pi])[2] == -math.pi
    assert wrap([0, 0, np.nextafter(-math.pi, -4)])[2] < math.pi
    shifted = make_system("dubins_car", state_bounds={"theta": (0, 2 * math.pi)})
    assert shifted.wrap([0, 0, -1e-20])[2] == 0.0


def test_control_samples_count_a_held_control_once():
    np.testing.assert_allclose(SYSTEMS["dubins_car"].control_samples(), [[1, -1], [1, 1]])
    free = make_system("dubins_car", control_bounds={"v": (-2, 2)})
    assert free.control_samples([5, 3]).shape == (15, 2)
    np.testing.assert_allclose(free.control_bounds, [[-2, -1], [2, 1]])
    np.testing.assert_allclose(free.disturbance_samples(), [[0, 0, 0]])
    windy = make_system("dubins_car", disturbance_bounds={"d_x": (-0.1, 0.1)})
    np.testing.assert_allclose(windy.disturbance_samples(), [[-0.1, 0, 0], [0.1, 0, 0]])


def test_a_system_without_controls_has_one_empty_sample():
    free = replace(SYSTEMS["dubins_car"], controls=(), equations=lambda _m, _p: lambda x, _u, _d: (-x[0], x[1], 0.0))
    assert free.control_samples().shape == free.control_samples(3).shape == (1, 0)
    np.testing.assert_allclose(free.dynamics([1.0, 2.0, 0.0], free.control_samples()), [-1.0, 2.0, 0.0])


def test_a_disturbance_that_is_held_acts_where_none_is_given():
    bounds = {"d_x": (0.5, 0.5), "d_y": (0.2, 0.4), "d_theta": (-0.1, 0.3)}
    boat = make_system("dubins_car", disturbance_bounds=bounds)
    np.testing.assert_allclose(boat.nominal_disturbance, [0.5, 0.3, 0.0])
    still = SYSTEMS["dubins_car"]
    x, u = np.array([0.0, 0.0, 0.5]), np.array([1.0, 1.0])
    np.testing.assert_allclose(boat.dynamics(x, u), still.dynamics(x, u) + np.array([0.5, 0.3, 0.0]))
    np.testing.assert_allclose(boat.dynamics(x, u, np.zeros(3)), still.dynamics(x, u))
    np.testing.assert_allclose(boat.step(x, u, dt=0.1), still.step(x, u, [0.5, 0.3, 0.0], dt=0.1))
    by_casadi = boat.dynamics(casadi.DM(x), casadi.DM(u), math=casadi)
    np.testing.assert_allclose(np.array(by_casadi).ravel(), boat.dynamics(x, u))


def test_units_of_the_disturbance_are_those_of_the_rates():
    units = {d.name: d.unit for d in SYSTEMS["planar_quadrotor"].disturbances}
    assert units["d_x"] == "m/s"
    assert units["d_v_x"] == "m/s^2"
    assert units["d_omega"] == "rad/s^2"


@pytest.mark.parametrize(
    ("arguments_", "message"),
    [
        ({"name": "unicorn"}, "unknown system 'unicorn'; choose one of dubins_car"),
        ({"name": "bicycle", "parameters": {"length": 1}}, "'length' is unknown; the system has wheelbase"),
        ({"name": "bicycle", "parameters": {"wheelbase": 0}}, "more than zero and finite"),
        ({"name": "bicycle", "parameters": {"wheelbase": "1 m"}}, "'1 m' is not a number"),
        ({"name": "bicycle", "parameters": {"wheelbase": True}}, "True is not a number"),
        ({"name": "planar_quadrotor", "parameters": {"C_v": -1}}, "zero or more"),
        ({"name": "dubins_car", "control_bounds": {"turn": (0, 1)}}, "'turn' is unknown; the system has v, omega"),
        ({"name": "dubins_car", "control_bounds": {"omega": (1, -1)}}, "lower <= upper"),
        ({"name": "dubins_car", "control_bounds": {"omega": (0, math.inf)}}, "two finite numbers"),
        ({"name": "dubins_car", "control_bounds": {"omega": (math.nan, 1)}}, "two finite numbers"),
        ({"name": "dubins_car", "control_bounds": {"omega": 1.0}}, "give two numbers"),
        ({"name": "dubins_car", "control_bounds": {"omega": "ab"}}, "give two numbers"),
        ({"name": "dubins_car", "state_bounds": {"theta": (0, 1)}}, "one period of 6.28319 rad"),
        ({"name": "dubins_car", "disturbance_bounds": {"x": (0, 1)}}, "the system has d_x, d_y, d_theta"),
    ],
)
def test_errors_of_make_system(arguments_, message):
    with pytest.raises(SystemModelError, match=message):
        make_system(**arguments_)


def test_errors_of_shapes():
    car = SYSTEMS["dubins_car"]
    with pytest.raises(SystemModelError, match="dubins_car: x has 2 components; the system has 3"):
        car.dynamics(np.zeros(2), [1, 0])
    with pytest.raises(SystemModelError, match="u has 1 components"):
        car.dynamics(casadi.MX.sym("x", 3), casadi.MX.sym("u", 1), math=casadi)
    with pytest.raises(SystemModelError, match="no components"):
        car.wrap(0.0)
    with pytest.raises(SystemModelError, match="at least 2"):
        car.control_samples(1)


def test_zero_drag_is_allowed():
    system = make_system("planar_quadrotor", parameters={"C_v": 0, "C_psi": 0}, state_bounds={"v_x": (-math.inf, 3)})
    assert system.parameters["C_v"] == 0
    assert system.states[1].upper == 3
