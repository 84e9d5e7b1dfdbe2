"""The equations of the six robot system models of thesis Table 3.1, each written once.

A model is a function `equations(math, p)` that returns `f(x, u, d)`: the state derivatives as a tuple. `math` is any
namespace with cos, sin and tan (`math` for Numba, NumPy, CasADi), `p` holds the parameters, and `x`, `u`, `d` can be
indexed by component. The Hamilton-Jacobi solver, the MPC and the tests therefore share the same code.

All six are affine in control and disturbance, so the Hamiltonian over a box of either is extremal at a vertex. The
disturbance is additive: `d[i]` enters the derivative of state `i` (the second player of thesis Eqs. 2.18-2.20).

Units are SI, frames follow REP-103 except the planar quadrotor, which keeps the thesis's signs.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, pi
from typing import Any

Dynamics = Callable[[Any, Any, Any], tuple[Any, ...]]
Equations = Callable[[Any, Mapping[str, float]], Dynamics]


@dataclass(frozen=True)
class Quantity:
    """One component of a state, control or disturbance, in [lower, upper] `unit`; wraps around if periodic."""

    name: str
    unit: str
    lower: float = -inf
    upper: float = inf
    periodic: bool = False


@dataclass(frozen=True)
class Parameter:
    """A constant of a model with its default; `may_be_zero` marks coefficients that 0 switches off."""

    name: str
    unit: str
    default: float
    may_be_zero: bool = False


@dataclass(frozen=True)
class SystemModel:
    """A row of thesis Table 3.1: components in the order in which `equations` indexes them."""

    states: tuple[Quantity, ...]
    controls: tuple[Quantity, ...]
    parameters: tuple[Parameter, ...]
    equations: Equations


def dubins_car(math: Any, p: Mapping[str, float]) -> Dynamics:
    """3D car (x, y, theta), controls (v, omega): thesis Eq. 3.7. `DUBINS_CAR` has its constant speed."""
    del p
    cos, sin = math.cos, math.sin

    def f(x: Any, u: Any, d: Any) -> tuple[Any, ...]:
        return (
            u[0] * cos(x[2]) + d[0],
            u[0] * sin(x[2]) + d[1],
            u[1] + d[2],
        )

    return f


def extended_dubins_car(math: Any, p: Mapping[str, float]) -> Dynamics:
    """5D car (x, y, theta, v, omega), controls (alpha_v, alpha_omega): thesis Eq. 3.8."""
    del p
    cos, sin = math.cos, math.sin

    def f(x: Any, u: Any, d: Any) -> tuple[Any, ...]:
        return (
            x[3] * cos(x[2]) + d[0],
            x[3] * sin(x[2]) + d[1],
            x[4] + d[2],
            u[0] + d[3],
            u[1] + d[4],
        )

    return f


def bicycle(math: Any, p: Mapping[str, float]) -> Dynamics:
    """4D kinematic bicycle (x, y, theta, delta), controls (v, omega_delta).

    (x, y) is the centre of the rear axle, delta the steering angle of the front wheel.
    """
    cos, sin, tan = math.cos, math.sin, math.tan
    wheelbase = p["wheelbase"]

    def f(x: Any, u: Any, d: Any) -> tuple[Any, ...]:
        return (
            u[0] * cos(x[2]) + d[0],
            u[0] * sin(x[2]) + d[1],
            u[0] * tan(x[3]) / wheelbase + d[2],
            u[1] + d[3],
        )

    return f


def planar_quadrotor(math: Any, p: Mapping[str, float]) -> Dynamics:
    """6D planar quadrotor (x, v_x, z, v_z, psi, omega), controls the thrusts (T_1, T_2): thesis Eq. 3.10."""
    cos, sin = math.cos, math.sin
    m, g, C_v, C_psi, I_yy, length = p["m"], p["g"], p["C_v"], p["C_psi"], p["I_yy"], p["l"]

    def f(x: Any, u: Any, d: Any) -> tuple[Any, ...]:
        thrust = u[0] + u[1]
        return (
            x[1] + d[0],
            (thrust * sin(x[4]) - C_v * x[1]) / m + d[1],
            x[3] + d[2],
            (thrust * cos(x[4]) - C_v * x[3]) / m - g + d[3],
            x[5] + d[4],
            (length * (u[0] - u[1]) - C_psi * x[5]) / I_yy + d[5],
        )

    return f


def quadrotor_rotation(math: Any, p: Mapping[str, float]) -> Dynamics:
    """6D rigid-body rotation (phi, theta, psi, p, q, r), controls the body torques (tau_x, tau_y, tau_z).

    State: roll, pitch and yaw (Z-Y-X Euler angles) and body rates; Euler's equations with a diagonal inertia. Singular
    at theta = +-pi/2.
    """
    cos, sin = math.cos, math.sin
    I_xx, I_yy, I_zz = p["I_xx"], p["I_yy"], p["I_zz"]

    def f(x: Any, u: Any, d: Any) -> tuple[Any, ...]:
        sin_phi, cos_phi, cos_theta = sin(x[0]), cos(x[0]), cos(x[1])
        yaw_rate = (sin_phi * x[4] + cos_phi * x[5]) / cos_theta
        return (
            x[3] + yaw_rate * sin(x[1]) + d[0],
            cos_phi * x[4] - sin_phi * x[5] + d[1],
            yaw_rate + d[2],
            ((I_yy - I_zz) * x[4] * x[5] + u[0]) / I_xx + d[3],
            ((I_zz - I_xx) * x[3] * x[5] + u[1]) / I_yy + d[4],
            ((I_xx - I_yy) * x[3] * x[4] + u[2]) / I_zz + d[5],
        )

    return f


def point_mass(math: Any, p: Mapping[str, float]) -> Dynamics:
    """3D point mass (x, y, z), controls the velocity (v_x, v_y, v_z).

    Table 3.1 counts states ("3D" versus "6D planar"), so velocity is the control rather than a state, as in an
    autopilot's velocity loop. The disturbance is wind that carries the mass along.
    """
    del math, p

    def f(_x: Any, u: Any, d: Any) -> tuple[Any, ...]:
        return (u[0] + d[0], u[1] + d[1], u[2] + d[2])

    return f


def _angle(name: str) -> Quantity:
    return Quantity(name, "rad", -pi, pi, periodic=True)


_X, _Y, _Z = Quantity("x", "m"), Quantity("y", "m"), Quantity("z", "m")

DUBINS_CAR = SystemModel(
    states=(_X, _Y, _angle("theta")),
    # With equal bounds, v is fixed: the Dubins car with constant speed. Bounds such as (-2, 2) free it for the MPC.
    controls=(Quantity("v", "m/s", 1.0, 1.0), Quantity("omega", "rad/s", -1.0, 1.0)),
    parameters=(),
    equations=dubins_car,
)
EXTENDED_DUBINS_CAR = SystemModel(
    states=(_X, _Y, _angle("theta"), Quantity("v", "m/s", -2.0, 2.0), Quantity("omega", "rad/s", -2.0, 2.0)),
    controls=(Quantity("alpha_v", "m/s^2", -1.0, 1.0), Quantity("alpha_omega", "rad/s^2", -2.0, 2.0)),
    parameters=(),
    equations=extended_dubins_car,
)
BICYCLE = SystemModel(
    states=(_X, _Y, _angle("theta"), Quantity("delta", "rad", -0.6, 0.6)),
    controls=(Quantity("v", "m/s", -2.0, 2.0), Quantity("omega_delta", "rad/s", -1.0, 1.0)),
    parameters=(Parameter("wheelbase", "m", 0.5),),
    equations=bicycle,
)
PLANAR_QUADROTOR = SystemModel(
    states=(
        _X,
        Quantity("v_x", "m/s", -2.0, 2.0),
        _Z,
        Quantity("v_z", "m/s", -2.0, 2.0),
        _angle("psi"),
        Quantity("omega", "rad/s", -pi / 2, pi / 2),
    ),
    controls=(Quantity("T_1", "N", 0.0, 12.26), Quantity("T_2", "N", 0.0, 12.26)),
    parameters=(
        Parameter("m", "kg", 1.25),
        Parameter("g", "m/s^2", 9.81, may_be_zero=True),
        Parameter("C_v", "N s/m", 0.25, may_be_zero=True),
        Parameter("C_psi", "N m s/rad", 0.02255, may_be_zero=True),
        Parameter("I_yy", "kg m^2", 0.03),
        Parameter("l", "m", 0.5),
    ),
    equations=planar_quadrotor,
)
QUADROTOR_ROTATION = SystemModel(
    states=(
        _angle("phi"),
        Quantity("theta", "rad", -pi / 2, pi / 2),
        _angle("psi"),
        Quantity("p", "rad/s"),
        Quantity("q", "rad/s"),
        Quantity("r", "rad/s"),
    ),
    # Roll and pitch: l (T_1 - T_2) of the planar quadrotor. Yaw is rotor drag, an order of magnitude weaker.
    controls=(
        Quantity("tau_x", "N m", -6.13, 6.13),
        Quantity("tau_y", "N m", -6.13, 6.13),
        Quantity("tau_z", "N m", -0.6, 0.6),
    ),
    # I_yy as for the planar quadrotor; a symmetric cross of rotors has I_xx = I_yy and nearly twice that about z.
    parameters=(
        Parameter("I_xx", "kg m^2", 0.03),
        Parameter("I_yy", "kg m^2", 0.03),
        Parameter("I_zz", "kg m^2", 0.055),
    ),
    equations=quadrotor_rotation,
)
POINT_MASS = SystemModel(
    states=(_X, _Y, _Z),
    controls=tuple(Quantity(f"v_{axis}", "m/s", -2.0, 2.0) for axis in "xyz"),
    parameters=(),
    equations=point_mass,
)

SYSTEM_MODELS: dict[str, SystemModel] = {
    "dubins_car": DUBINS_CAR,
    "extended_dubins_car": EXTENDED_DUBINS_CAR,
    "bicycle": BICYCLE,
    "planar_quadrotor": PLANAR_QUADROTOR,
    "quadrotor_rotation": QUADROTOR_ROTATION,
    "point_mass": POINT_MASS,
}
