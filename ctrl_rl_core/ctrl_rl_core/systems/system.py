"""A robot system: a model of thesis Table 3.1 with its parameters and bounds, usable from NumPy, Numba and CasADi.

car = make_system("dubins_car", control_bounds={"v": (1.0, 1.0), "omega": (-1.0, 1.0)})
car.dynamics(x, u)                       # NumPy, x (..., 3), u (..., 2)
car.dynamics(x, u, math=casadi)          # CasADi, x (3, N), u (2, N)
f = car.numba_dynamics()                 # f((x, y, theta), (v, omega), (0., 0., 0.)) inside a jitted loop
"""

import math as scalar_math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core.systems.models import Dynamics, Equations, Parameter, Quantity
from ctrl_rl_core.systems.registry import SystemModelError as SystemModelError
from ctrl_rl_core.systems.registry import find_model

Bounds = Mapping[str, Sequence[float]]

_DERIVATIVE_UNITS = {"m": "m/s", "rad": "rad/s", "m/s": "m/s^2", "rad/s": "rad/s^2"}


@dataclass(frozen=True, eq=False)
class System:
    """A system x' = f(x, u, d) with n states, m controls and n additive disturbances. Created by `make_system`."""

    name: str
    states: tuple[Quantity, ...]
    controls: tuple[Quantity, ...]
    disturbances: tuple[Quantity, ...]
    parameters: Mapping[str, float]
    equations: Equations

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in the order of x."""
        return tuple(state.name for state in self.states)

    @cached_property
    def control_names(self) -> tuple[str, ...]:
        """Names of the controls, in the order of u."""
        return tuple(control.name for control in self.controls)

    @cached_property
    def control_bounds(self) -> NDArray[np.float64]:
        """Lower and upper bounds of u, shape (2, m); equal bounds fix a control."""
        return _bounds_array(self.controls)

    @cached_property
    def disturbance_bounds(self) -> NDArray[np.float64]:
        """Lower and upper bounds of d, shape (2, n)."""
        return _bounds_array(self.disturbances)

    @cached_property
    def nominal_disturbance(self) -> NDArray[np.float64]:
        """Default disturbance (n,): zero, or the midpoint of bounds that exclude zero.

        A steady current has equal bounds, and is its own midpoint.
        """
        lower, upper = self.disturbance_bounds
        nominal = np.where((lower <= 0.0) & (upper >= 0.0), 0.0, 0.5 * (lower + upper))
        nominal.flags.writeable = False
        return nominal

    def control_samples(self, counts: int | Sequence[int] = 2) -> NDArray[np.float64]:
        """Evenly spaced controls that include the bounds, shape (k, m); two per control give the vertices of the box.

        A fixed control (equal bounds) counts once, so the Dubins car at constant speed has two vertices. A system
        without controls has one empty sample.
        """
        return _box_samples(self.controls, counts)

    def disturbance_samples(self, counts: int | Sequence[int] = 2) -> NDArray[np.float64]:
        """As `control_samples`, for the disturbance, shape (k, n); one row of zeros without disturbance."""
        return _box_samples(self.disturbances, counts)

    def dynamics(self, x: Any, u: Any, d: Any = None, *, math: Any = np) -> Any:
        """State derivative f(x, u, d) in units per second.

        Args:
            x: States, shape (..., n); for CasADi (n, N), one state per column.
            u: Controls, shape (..., m) or (m, N); broadcast against x.
            d: Disturbances shaped like x, or None for `nominal_disturbance`.
            math: Namespace of cos, sin, tan: the numpy or casadi module.

        Returns:
            An array (..., n), or for CasADi an (n, N) expression.

        Raises:
            SystemModelError: The number of components does not match the system.
        """
        n, m = len(self.states), len(self.controls)
        if d is None:
            disturbance: tuple[Any, ...] = tuple(self.nominal_disturbance.tolist())
        else:
            disturbance = _components(d, n, f"{self.name}: d", math)
        f = self.equations(math, self.parameters)
        rates = f(_components(x, n, f"{self.name}: x", math), _components(u, m, f"{self.name}: u", math), disturbance)
        if math is np:
            return np.stack(np.broadcast_arrays(*rates), axis=-1)
        return math.vertcat(*rates)

    def step(self, x: Any, u: Any, d: Any = None, *, dt: Any, math: Any = np) -> Any:
        """State after `dt` seconds of constant u and d: one step of the classical Runge-Kutta method (fourth order).

        Shapes and errors as for `dynamics`. Periodic states are not wrapped, which keeps them smooth for an optimiser.
        """
        if math is np:
            x = np.asarray(x, dtype=np.float64)
        k1 = self.dynamics(x, u, d, math=math)
        k2 = self.dynamics(x + dt / 2 * k1, u, d, math=math)
        k3 = self.dynamics(x + dt / 2 * k2, u, d, math=math)
        k4 = self.dynamics(x + dt * k3, u, d, math=math)
        return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def wrap(self, x: ArrayLike) -> NDArray[np.float64]:
        """Return a copy of the states (..., n) with each periodic one wrapped to [lower, upper)."""
        wrapped = np.array(x, dtype=np.float64)
        _check_count(wrapped.shape[-1:], len(self.states), f"{self.name}: x")
        for i, state in enumerate(self.states):
            if state.periodic:
                angle = state.lower + np.mod(wrapped[..., i] - state.lower, state.upper - state.lower)
                # The remainder of a tiny negative number rounds up to the full period.
                wrapped[..., i] = np.where(angle >= state.upper, state.lower, angle)
        return wrapped

    def numba_dynamics(self) -> Dynamics:
        """Compile `f(x, u, d)` with the parameters as constants: tuples (or arrays) in, a tuple of n floats out.

        The function allocates nothing, and a jitted caller that closes over it inlines it. Equal systems share one
        function.
        """
        return _compile(self.equations, tuple(self.parameters.items()))


def make_system(
    name: str,
    *,
    parameters: Mapping[str, float] | None = None,
    state_bounds: Bounds | None = None,
    control_bounds: Bounds | None = None,
    disturbance_bounds: Bounds | None = None,
) -> System:
    """Create the system `name` of thesis Table 3.1, with optional changes.

    Args:
        name: One of dubins_car, extended_dubins_car, bicycle, planar_quadrotor, quadrotor_rotation, point_mass, or a
            model of another package, see `registry`.
        parameters: Constants by name, in the units declared by the model.
        state_bounds: (lower, upper) by state name; may be infinite. A periodic state keeps the length of its period.
        control_bounds: (lower, upper) by control name; equal bounds fix the control.
        disturbance_bounds: (lower, upper) by name, which is "d_" plus the state's name; zero by default.

    Raises:
        SystemModelError: A name is unknown, or numbers are not finite, not in order or not positive.
    """
    model = find_model(name)
    disturbances = tuple(
        Quantity(f"d_{s.name}", _DERIVATIVE_UNITS.get(s.unit, f"{s.unit}/s"), 0.0, 0.0) for s in model.states
    )
    return System(
        name=name,
        states=_with_bounds(model.states, state_bounds or {}, f"{name}: state", finite=False),
        controls=_with_bounds(model.controls, control_bounds or {}, f"{name}: control", finite=True),
        disturbances=_with_bounds(disturbances, disturbance_bounds or {}, f"{name}: disturbance", finite=True),
        parameters=_with_values(model.parameters, parameters or {}, f"{name}: parameter"),
        equations=model.equations,
    )


def _with_values(defaults: tuple[Parameter, ...], values: Mapping[str, float], what: str) -> Mapping[str, float]:
    _check_names(values, [parameter.name for parameter in defaults], what)
    result = {}
    for parameter in defaults:
        value = _number(values.get(parameter.name, parameter.default), f"{what} '{parameter.name}'")
        if not scalar_math.isfinite(value) or value < 0 or (value == 0 and not parameter.may_be_zero):
            least = "zero or more" if parameter.may_be_zero else "more than zero"
            raise SystemModelError(
                f"{what} '{parameter.name}' is {value:g}; it must be {least} and finite [{parameter.unit}]"
            )
        result[parameter.name] = value
    return MappingProxyType(result)


def _with_bounds(defaults: tuple[Quantity, ...], bounds: Bounds, what: str, *, finite: bool) -> tuple[Quantity, ...]:
    _check_names(bounds, [quantity.name for quantity in defaults], what)
    return tuple(
        _with_bound(quantity, bounds[quantity.name], f"{what} '{quantity.name}'", finite)
        if quantity.name in bounds
        else quantity
        for quantity in defaults
    )


def _with_bound(quantity: Quantity, pair: Sequence[float], what: str, finite: bool) -> Quantity:
    if isinstance(pair, str) or not isinstance(pair, Sequence | np.ndarray) or len(pair) != 2:
        raise SystemModelError(f"{what}: bounds are {pair!r}; give two numbers, [lower, upper], in {quantity.unit}")
    lower, upper = (_number(number, what) for number in pair)
    if not lower <= upper or (finite and not (scalar_math.isfinite(lower) and scalar_math.isfinite(upper))):
        kind = "finite numbers" if finite else "numbers"
        raise SystemModelError(f"{what}: bounds are [{lower:g}, {upper:g}]; give two {kind} with lower <= upper")
    if quantity.periodic and not scalar_math.isclose(upper - lower, quantity.upper - quantity.lower, rel_tol=1e-6):
        period = quantity.upper - quantity.lower
        raise SystemModelError(
            f"{what}: bounds are [{lower:g}, {upper:g}], but it is periodic; give one period of {period:.6g} rad"
        )
    return replace(quantity, lower=lower, upper=upper)


def _number(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise SystemModelError(f"{what}: {value!r} is not a number")
    return float(value)


def _check_names(given: Mapping[str, Any], known: Sequence[str], what: str) -> None:
    for name in given:
        if name not in known:
            raise SystemModelError(f"{what} '{name}' is unknown; the system has {', '.join(known) or 'none'}")


def _check_count(shape: Sequence[int], count: int, what: str) -> None:
    if tuple(shape) != (count,):
        found = shape[0] if shape else "no"
        raise SystemModelError(f"{what} has {found} components; the system has {count}")


def _components(values: Any, count: int, what: str, math: Any) -> tuple[Any, ...]:
    """Split an array (..., count), a tuple, or a CasADi matrix (count, N) into its components."""
    if math is np:
        array = np.asarray(values, dtype=np.float64)
        _check_count(array.shape[-1:], count, what)
        return tuple(np.moveaxis(array, -1, 0))
    if isinstance(values, tuple | list | np.ndarray):
        _check_count((len(values),), count, what)
        return tuple(values)
    _check_count((values.shape[0],), count, what)
    return tuple(values[i, :] for i in range(count))


def _bounds_array(quantities: tuple[Quantity, ...]) -> NDArray[np.float64]:
    bounds = np.array([[q.lower for q in quantities], [q.upper for q in quantities]])
    bounds.flags.writeable = False
    return bounds


def _box_samples(quantities: tuple[Quantity, ...], counts: int | Sequence[int]) -> NDArray[np.float64]:
    each = [counts] * len(quantities) if isinstance(counts, int) else list(counts)
    if len(each) != len(quantities) or min(each, default=2) < 2:
        raise SystemModelError(
            f"sample counts are {counts}; give at least 2 for each of {[q.name for q in quantities]}"
        )
    if not quantities:
        return np.zeros((1, 0))
    ticks = [
        np.linspace(q.lower, q.upper, 1 if q.lower == q.upper else count)
        for q, count in zip(quantities, each, strict=True)
    ]
    return np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, len(quantities))


@lru_cache(maxsize=32)
def _compile(equations: Equations, parameters: tuple[tuple[str, float], ...]) -> Dynamics:
    # Imported here, since only the Hamilton-Jacobi solver needs Numba while every reader of a task imports this module.
    from numba import njit

    # NumPy's error model: division by zero gives inf, without a check in the inner loop.
    return njit(error_model="numpy")(equations(scalar_math, dict(parameters)))
