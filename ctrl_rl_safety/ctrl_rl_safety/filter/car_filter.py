"""The safety filter of a car: scans, evidence and bounds as of other robots, and a certificate with steering."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.filter.car_certificate import CarSituation, answer_car, car_path
from ctrl_rl_safety.filter.evidence import Beams
from ctrl_rl_safety.filter.map_walls import Fixed
from ctrl_rl_safety.filter.safety_filter import STEP, SafetyFilter
from ctrl_rl_safety.filter.seen_space import Sight
from ctrl_rl_safety.filter.verdict import FilterOptions, Mode, Reading, Verdict
from ctrl_rl_safety.models.car_model import CarModel, steered_of
from ctrl_rl_safety.models.motion import STANDS
from ctrl_rl_safety.models.robot_model import RobotModel
from ctrl_rl_safety.sets.distance_field import Obstacles
from ctrl_rl_safety.sets.recoverable_set import RecoverableSet

Array = NDArray[np.float64]

_SPEEDS = (1.0, 0.6, 0.3, 0.1)
_CURVATURES = (0.0, 0.4, -0.4, 1.0, -1.0)
"""Speeds as fractions of the raw one, and differences of the curvature as fractions of the tightest, of corrections."""
_TURN_COST = 0.6
"""Cost of the largest difference of the curvature, relative to that of the whole speed."""
_ORDER = sorted(product(_SPEEDS, _CURVATURES), key=lambda each: 1.0 - each[0] + _TURN_COST * abs(each[1]))
_LONGEST = 2.0
"""Time of commands from which the steering angle is found while the car stands [s]."""
_MEASURABLE = 0.15
"""Fraction of the speed above which the turn rate tells the steering angle."""


class CarFilter(SafetyFilter):
    """Keeps one car where it can brake along its present arc without contact.

    A car's escape is braking with its front wheels as they are, so there is no set of other escapes, no turn that
    unblocks it, and it does not evade.

    Attributes:
        model: Model of the car.
    """

    model: CarModel

    def __init__(self, model: CarModel, options: FilterOptions | None = None) -> None:
        super().__init__(model, options)
        self._steering, self._steered_at = 0.0, -math.inf

    def see(
        self,
        now: float,
        pose: Array,
        echoes: Array,
        age: float = 0.0,
        fixed: Fixed | None = None,
        sight: Sight | None = None,
        beams: Beams | None = None,
    ) -> None:
        """Process a scan, in the frame of the rear axle, see `SafetyFilter.see`."""
        ahead = self.model.centre
        middle = np.array((pose[0] + ahead * math.cos(pose[2]), pose[1] + ahead * math.sin(pose[2]), pose[2]))
        if beams is not None:
            beams = beams._replace(ends=beams.ends - (ahead, 0.0), forward=beams.forward - ahead)
        if sight is not None:
            sight = sight._replace(forward=sight.forward - ahead)
        echoes = echoes - (ahead, 0.0)
        inside = np.array(self.model.core) - self.model.range_error
        echoes = echoes[(np.abs(echoes) >= inside).any(axis=1)]  # a lidar may see its own wheels
        super().see(now, middle, echoes, age, fixed, sight, beams)

    def solve(self) -> RecoverableSet | None:
        """Return None: a car has one escape."""
        return None

    def forget(self) -> None:
        """Discard scans, because the odometry frame has jumped; several new scans are needed from now on."""
        super().forget()
        self._steered_at = -math.inf

    def decide(self, now: float, reading: Reading, raw: Array) -> Verdict:
        """Return the command to send in place of a raw one (2,) [m/s, rad/s].

        Raises:
            SafetyError: No scan has been received.
        """
        if self._seen is None:
            raise SafetyError("no scan yet")
        obstacles, seen_at = self._seen
        wanted = self._limited(raw)
        begin = np.array((*reading.pose, reading.v, self._angle(now, reading)))
        patience = self._patience(now)
        tried = np.array(self._tried(wanted))
        steps = np.full(len(tried), patience)
        needed = np.zeros(len(tried))
        steps[[0, -1]] = patience if self._corrected else self._hold, self._hold
        needed[0] = self.options.hysteresis if self._corrected and wanted[0] != 0.0 else 0.0
        under_way = self._under_way(now, reading.age, self.model.delay)
        situation = self._car_situation(obstacles)
        number, margin, state = answer_car(
            situation, begin, now - reading.age - seen_at, under_way, tried, steps, needed
        )
        mode = Mode.PASSED if number == 0 else Mode.CORRECTED
        if number == len(tried) - 1 and (number > 0 or margin < 0.0):
            mode = Mode.ESCAPING
        self._corrected = mode is not Mode.PASSED
        return Verdict(tried[number].copy(), mode, float(margin), math.nan, np.array(state))

    def escape(self, verdict: Verdict) -> Array:
        """Return the states (n, 5) of the car's middle under a verdict's command and while braking, for plotting."""
        if self._seen is None:
            return np.empty((0, 5))
        v, omega = verdict.command.tolist()
        path: Array = car_path(self._car_situation(self._seen[0]), verdict.state, (v, omega), self._hold)
        return path

    def stopping(self, now: float) -> Array:  # noqa: ARG002 - as SafetyFilter
        """Return the command (2,) of the certified escape: to brake, with the front wheels as they are."""
        return np.zeros(2)

    def _limited(self, raw: Array) -> tuple[float, float]:
        """Return speed and turn rate within the car's limits; at rest it cannot turn."""
        v = min(max(float(raw[0]), -self.model.reverse_speed), self.model.speed)
        if abs(v) < STANDS:
            return 0.0, 0.0
        most = abs(v) / self.model.turning_radius
        return v, min(max(float(raw[1]), -most), most)

    def _tried(self, wanted: tuple[float, float]) -> list[tuple[float, float]]:
        """Return the commands to certify in turn: the raw one, those nearest to it, and braking."""
        v, omega = wanted
        if v == 0.0:
            return [wanted]
        tightest = 1.0 / self.model.turning_radius
        out = [wanted]
        for share, aside in _ORDER:
            curvature = min(max(omega / v + aside * tightest, -tightest), tightest)
            if abs(share * v) >= STANDS:
                out.append((share * v, share * v * curvature))
        return [*out, (0.0, 0.0)]

    def _angle(self, now: float, reading: Reading) -> float:
        """Return the steering angle at the odometry's time: measured while the car drives, else by its commands."""
        model, car = self.model, steered_of(self.model, STEP)
        if abs(reading.v) >= _MEASURABLE * model.speed:
            angle = math.atan(model.wheelbase * reading.omega / reading.v)
            self._steering, self._steered_at = min(max(angle, -car.angle), car.angle), now - reading.age
            return self._steering
        until = now - reading.age
        count = math.floor(min(until - self._steered_at, _LONGEST) / STEP + 1e-9)
        for v, omega in self._under_way(until, count * STEP, model.delay)[:count] if count > 0 else ():
            if v != 0.0:
                wanted = min(max(math.atan(model.wheelbase * omega / v), -car.angle), car.angle)
                self._steering += min(max(car.share * (wanted - self._steering), -car.most), car.most)
        self._steered_at = until if count > 0 else self._steered_at
        return self._steering

    def _car_situation(self, obstacles: Obstacles) -> CarSituation:
        model = self.model
        steered = steered_of(model, STEP)
        return CarSituation(obstacles, self._growth, self._motion, steered, model.core, model.room, model.lag)


def make_filter(model: RobotModel, options: FilterOptions | None = None) -> SafetyFilter:
    """Return the filter of a robot or of a car.

    Raises:
        SafetyError: It brakes too slowly for a certificate to cover its stop.
    """
    return CarFilter(model, options) if isinstance(model, CarModel) else SafetyFilter(model, options)
