"""A guard for a planar quadrotor: passes thrusts that leave an escape, and corrects all others.

guard = FlightGuard(quadrotor_of(task), (*world.walls, *world.obstacles))
verdict = guard.decide(state, raw)     # once per tick
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import Interval, Region, Shape
from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.flight.escapes import KnownWorld, best_escape, nearest_safe, record
from ctrl_rl_safety.flight.motion import craft_of, escape_thrusts, moved, shape_rows
from ctrl_rl_safety.models.quadrotor_model import QuadrotorModel

Array = NDArray[np.float64]

_DIRECTIONS = 16
_PUSHES = (0.15, 0.4, 0.8)  # durations of acceleration in escapes [s]
_LEVELS = 4  # number of values per thrust to try in place of the raw ones


@dataclass(frozen=True)
class FlightOptions:
    """Settings of a `FlightGuard`.

    Attributes:
        tick: Control period [s].
        margin: Clearance that an escape must keep, to cover errors of model, state and shapes [m].
        hysteresis: Additional clearance required for the raw thrusts to pass again [m].

    Raises:
        SafetyError: A number is not finite or is out of range.
    """

    tick: float = 0.025
    margin: float = 0.05
    hysteresis: float = 0.02

    def __post_init__(self) -> None:
        if not (math.isfinite(self.tick) and 0.001 <= self.tick <= 0.1):
            raise SafetyError(f"tick is {self.tick:g} s: give 0.001 to 0.1")
        for name, number in (("margin", self.margin), ("hysteresis", self.hysteresis)):
            if not (math.isfinite(number) and 0.0 <= number <= 1.0):
                raise SafetyError(f"{name} is {number:g} m: give 0 to 1")


class FlightVerdict(NamedTuple):
    """Answer of a `FlightGuard`.

    Attributes:
        thrusts: Thrusts T_1 and T_2 to send (2,) [N].
        changed: Whether the thrusts differ from the raw ones.
        room: Clearance of the best known escape [m]; negative if the model has no way out.
        escaping: Whether the thrusts are those of an escape, because no others leave one.
    """

    thrusts: Array
    changed: bool
    room: float
    escaping: bool = False


class FlightGuard:
    """Passes thrusts to a planar quadrotor as long as an escape remains one tick later."""

    def __init__(
        self,
        model: QuadrotorModel,
        shapes: Sequence[Shape],
        options: FlightOptions | None = None,
        goal: Region | None = None,
    ) -> None:
        """Set the quadrotor and the shapes to avoid.

        Args:
            model: Constants of the quadrotor.
            shapes: Walls and obstacles in the x-z plane.
            options: Settings; the default ones if omitted.
            goal: Goal region of x, z and psi, where the flight and thus an escape may end; None for flights that must
                stay safe indefinitely.
        """
        self.options = options or FlightOptions()
        self._craft = craft_of(model, self.options.tick)
        self._world = KnownWorld(shape_rows(shapes), _goal_row(goal))
        levels = np.linspace(model.least, model.most, _LEVELS)
        self._levels = np.stack(np.meshgrid(levels, levels, indexing="ij"), axis=-1).reshape(-1, 2)
        angles = 2.0 * math.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        pushes = [(angle, push) for push in _PUSHES for angle in angles]
        self._plans = np.array([(0.0, 0.0), (0.0, 0.0), *pushes])  # the first one is the last answer's
        self.forget()

    def forget(self) -> None:
        """Reset the guard, e.g. for another flight."""
        self._plans[0] = 0.0
        self._way_out = np.zeros((0, 2))  # thrusts of the escape left by the last answer
        self._changed = False

    def warm_up(self) -> None:
        """Compile the guard's functions, and reset it."""
        hover = np.full(2, 0.5 * self._craft.mass * self._craft.gravity)
        for asked in (hover, hover, np.full(2, math.nan)):
            self.decide(np.zeros(6), asked)
        self.room(np.zeros(6))
        self.moved_on(np.zeros(6), hover, self.options.tick)
        self.forget()

    def room(self, state: ArrayLike) -> float:
        """Return the clearance of the best escape from a state [m]; non-negative if the state is recoverable."""
        value, _ = best_escape(self._craft, self._world, _state(state), self._plans[1:], self._way_out[:0], math.inf)
        return float(value)

    def decide(self, state: ArrayLike, raw: ArrayLike) -> FlightVerdict:
        """Return the thrusts for the next tick.

        Args:
            state: State x, v_x, z, v_z, psi, omega (6,), in the frame of the shapes.
            raw: Requested thrusts (2,) [N]; if they are not finite, the guard brakes and hovers.

        Raises:
            SafetyError: The state is not six finite numbers.
        """
        now, asked = _state(state), np.asarray(raw, dtype=np.float64)
        usable = asked.shape == (2,) and np.isfinite(asked).all()
        found = self._nearest(now, asked if usable else np.array(escape_thrusts(self._craft, now, 0.0, 0.0)))
        if found is not None:
            return found if usable else found._replace(changed=True)
        craft = self._craft
        room, plan = best_escape(craft, self._world, now, self._plans, self._way_out, self.options.margin)
        if plan >= 0:
            self._plans[0] = self._plans[plan]
            self._way_out = record(craft, now, self._plans[0])
        thrusts = self._way_out[0] if len(self._way_out) else np.array(escape_thrusts(craft, now, 0.0, 0.0))
        self._way_out = self._way_out[1:]
        self._changed = True
        return FlightVerdict(thrusts, True, float(room), True)

    def change(self, state: ArrayLike, raw: ArrayLike) -> FlightVerdict | None:
        """Recompute thrusts mid-tick for a new request; None if unchanged.

        The next tick then starts now. Arguments as for `decide`.

        Raises:
            SafetyError: The state is not six finite numbers.
        """
        asked = np.asarray(raw, dtype=np.float64)
        return self._nearest(_state(state), asked) if asked.shape == (2,) and np.isfinite(asked).all() else None

    def _nearest(self, now: tuple[float, ...], asked: Array) -> FlightVerdict | None:
        """Return the thrusts nearest to the requested ones that leave an escape; None if there are none."""
        craft = self._craft
        asked = np.clip(asked, craft.least, craft.most)
        near = self._levels[np.argsort(np.hypot(*(self._levels - asked).T), kind="stable")]
        tried = np.concatenate((asked[None], near))
        enough = self.options.margin + self._changed * self.options.hysteresis
        number, room, plan, after = nearest_safe(craft, self._world, now, tried, self._plans, enough)
        if number < 0:
            return None
        self._changed = number > 0
        self._plans[0] = self._plans[plan]
        self._way_out = record(craft, after, self._plans[0])
        return FlightVerdict(tried[number], self._changed, float(room))

    def escape_on(self) -> Array | None:
        """Return the thrusts (2,) for the next tick of the last certified escape, for use without current data.

        Each call is a tick; returns None at the end of the escape, where the quadrotor hovers, and before the first
        answer.
        """
        if not len(self._way_out):
            return None
        thrusts: Array = self._way_out[0]
        self._way_out, self._changed = self._way_out[1:], True
        return thrusts

    def moved_on(self, state: ArrayLike, thrusts: ArrayLike, seconds: float) -> Array:
        """Return the state (6,) predicted after holding thrusts (2,) for up to a tick [s].

        Raises:
            SafetyError: The state is not six finite numbers.
        """
        t_1, t_2 = np.asarray(thrusts, dtype=np.float64).tolist()
        return np.array(moved(self._craft, _state(state), t_1, t_2, seconds))


def _goal_row(goal: Region | None) -> Array:
    """Return a goal as a row of `KnownWorld`; a disc of zero size for none."""
    if goal is None:
        return np.array((math.inf, -math.inf) * 3 + (0.0, 0.0, -1.0))
    everywhere = Interval(-math.inf, math.inf)
    bounds = [bound for name in ("x", "z", "psi") for bound in goal.intervals.get(name, everywhere)]
    disc = (0.0, 0.0, math.inf) if goal.disc is None else (*goal.disc.centre, goal.disc.radius)
    return np.array((*bounds, *disc), dtype=np.float64)


def _state(state: ArrayLike) -> tuple[float, ...]:
    given = np.asarray(state, dtype=np.float64)
    if given.shape != (6,) or not np.isfinite(given).all():
        raise SafetyError("the state of a quadrotor is six finite numbers: x, v_x, z, v_z, psi, omega")
    return tuple(given.tolist())
