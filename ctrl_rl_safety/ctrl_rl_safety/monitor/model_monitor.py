"""Predict the robot's motion from its commands, and continuously compare it with the measured motion.

The bounds of the model grow at the first measurement outside them, and a robot that is worse than any bound stops.
Until the robot has demonstrated its braking and its delay, the model assumes less braking and more delay.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_safety.models.motion import STANDS
from ctrl_rl_safety.models.robot_model import RobotModel
from ctrl_rl_safety.monitor.bounds import LEAST_BRAKING, LEAST_TURNING, Bounds
from ctrl_rl_safety.monitor.follower import LATER, UNKNOWN, Follower, intervals
from ctrl_rl_safety.monitor.slip import Slip

Array = NDArray[np.float64]

_BUILDS = (0.0, 0.03, 0.1, 0.2, 0.35, 0.5, 0.75, 1.05, 1.5, 3.0, 1e3)
"""Edges of the intervals of the acceleration relative to the stated one, which is an upper bound."""
_STATED = 7
"""Number of those intervals within the stated bound."""
_SHEDS = (1e3, 0.95, 0.87, 0.78, 0.7, 0.6, 0.5, 0.4, LEAST_BRAKING)
"""Edges of the intervals of the braking relative to the stated one, which is a lower bound."""
_TURNS = (1e3, 0.9, 0.75, 0.6, 0.4, LEAST_TURNING)
"""The same for the turn acceleration."""
_ERRORS = 0.02, 0.05
"""Errors of a measured speed [m/s] and turn rate [rad/s] near zero."""
_SLACK = 0.1
"""Fraction of its maximum speed by which a robot may exceed every command, for example on a slope."""
_TURN_SLACK, _LEAST_TURN_SLACK = 0.2, 0.3
"""The same of its turn rate, which shakes as wheels slip, and the least that is borne [rad/s]."""
_SLOWLY = 0.25
"""Fraction of the maximum speed up to which a robot must turn as commanded, and the same of the turn rate."""
_UNSEEN_DELAY = 0.06
"""Delay beyond the stated one that a start does not reveal [s]."""
_UNSEEN_BRAKING = 0.87
"""Braking relative to the stated one that no stop can distinguish from it."""
_LONGEST = 0.3
"""Maximum interval between two compared measurements [s]."""
_ANY = (-np.inf, -UNKNOWN, UNKNOWN, -UNKNOWN, UNKNOWN)
"""Time of any command before the first one, and its lowest and highest speed and turn rate."""
_KEPT = 1.5
"""Time beyond the stated delay for which commands are stored [s]: the longest delay plus the longest interval."""
_LARGEST_SLIP = 0.5
"""Maximum tolerated disturbance, as a fraction of the speed."""
_PUSHED = "the robot moves although it is told to stand: is it pushed, or does somebody else command it?"
_LOST = "the robot {} than any bound allows: measure it with `identify`, mend it, then start the filter again"


class ModelMonitor:
    """Bounds of a robot's motion that cover all measurements of it.

    Args:
        stated: Model of the robot.
        unproven_braking: Fraction of the stated braking to discount until the robot has demonstrated it.
        unproven_delay: Delay to add to the stated one until the robot has demonstrated a shorter one [s].

    Attributes:
        stated: Model of the robot.
        model: The same model with the current bounds.
        grown: Deviations from the model found so far.
        unproven: Margins for properties that the robot has not demonstrated yet.
        problem: Reason why the robot must stop; empty if there is none.
    """

    def __init__(self, stated: RobotModel, unproven_braking: float = 0.2, unproven_delay: float = 0.15) -> None:
        self.stated, self.grown = stated, Bounds()
        self.unproven = Bounds(delay=unproven_delay, braking=1.0 - unproven_braking)
        self.problem = ""
        builds = [(stated.acceleration * a, stated.acceleration * b) for a, b in intervals(_BUILDS)]
        sheds = [(stated.braking * a, stated.braking * b) for a, b in intervals(_SHEDS)]
        turns = [(stated.turn_acceleration * a, stated.turn_acceleration * b) for a, b in intervals(_TURNS)]
        self._speed = Follower(stated.delay, stated.lag, builds, _STATED, sheds, _ERRORS[0], _SLACK * stated.speed)
        slack = max(_LEAST_TURN_SLACK, _TURN_SLACK * stated.turn_rate)
        self._turn = Follower(stated.delay, stated.lag, (), 0, turns, _ERRORS[1], slack, tied=True)
        self._slip = Slip()
        self._sent: deque[tuple[float, float, float, float, float]] = deque((_ANY,))
        self._last: tuple[float, float, float] | None = None
        self._rested = self._pushed = False
        self._use()

    def sent(self, now: float, command: Array) -> None:
        """Record a command (2,) [m/s, rad/s] that was sent to the robot at a steady time [s]."""
        v, omega = float(command[0]), float(command[1])
        self._sent.append((now, v, v, omega, omega))
        while len(self._sent) > 1 and self._sent[1][0] < now - self.stated.delay - _KEPT:
            self._sent.popleft()

    def forget(self) -> None:
        """Restart because time or the odometry frame has jumped; keep the bounds that have grown."""
        self._slip.forget()
        self._last = None
        self._sent.clear()
        self._sent.append(_ANY)

    def measure(self, time: float, pose: Array, v: float, omega: float) -> None:
        """Judge the motion since the last measurement, and update `model`.

        Args:
            time: Steady time of the measurement [s].
            pose: Pose of the odometry (3,) [m, m, rad].
            v: Speed [m/s].
            omega: Turn rate [rad/s].
        """
        last = self._last
        if last is not None and time <= last[0]:
            return
        self._last = time, v, omega
        self._slip.measure(time, pose, v)
        stands = abs(v) < self._speed.error(0.0) and abs(omega) < self._turn.error(0.0)
        if last is None and stands and self._sent[0] is _ANY:
            self._sent[0] = (-np.inf, 0.0, 0.0, 0.0, 0.0)
        whole = np.array(self._sent)
        speeds, turns = whole[:, (0, 1, 2)], whole[:, (0, 3, 4)]
        told = self._speed.told(speeds, time), self._turn.told(turns, time)
        if last is None or time - last[0] > _LONGEST or self._moved_by_others(told, stands):
            self._speed.begin(v)
            self._turn.begin(omega)
            self._use()
            return
        coupled = [self.stated.track > 0.0 and most - least > STANDS for least, most in told]
        # Wheels at their full speed leave none to turn with, and turning takes from the speed.
        limits = self.stated.speed, self.stated.turn_rate
        crowded = [max(map(abs, each)) > _SLOWLY * limit for each, limit in zip(told, limits, strict=True)]
        known, any_ = self._turn.grown.delay, np.ones(len(LATER), np.bool_)
        self._speed.measure(speeds, last[0], time, v, coupled[1], crowded[1], known, any_)
        # Turn rates shake as wheels slip: what the speed has shown of the delay counts for more.
        known, possible = self._speed.grown.delay, self._speed.delays
        if not self.stated.steered:  # a car's turn rate follows from its speed and its front wheels
            self._turn.measure(turns, last[0], time, omega, coupled[0], crowded[0], known, possible)
        self._use()

    @property
    def soonest(self) -> float:
        """Shortest delay that the measurements leave possible, from the stated one on [s]."""
        possible = self._speed.delays & self._turn.delays
        first = int(np.argmax(possible if possible.any() else self._speed.delays))
        return self.stated.delay + LATER[max(first - 1, 0)]

    def _moved_by_others(self, told: tuple[tuple[float, float], ...], stands: bool) -> bool:
        """Return whether a standing robot moves without a command, until it stands again."""
        if max(abs(each) for both in told for each in both) >= STANDS:
            self._rested = self._pushed = False
        elif stands:
            self._rested, self._pushed = True, False
        elif self._rested:
            self._pushed = True
        return self._pushed

    def _use(self) -> None:
        """Set the model to the current bounds."""
        speed, turn, stated = self._speed.grown, self._turn.grown, self.stated
        excess = max(self._speed.gain * max(stated.speed, stated.reverse_speed), self._speed.excess)
        self.grown = Bounds(
            delay=LATER[max(speed.delay, turn.delay)],
            acceleration=max(_BUILDS[speed.build + 1], 1.0) if speed.build >= _STATED else 1.0,
            braking=min(_SHEDS[speed.shed + 1], 1.0) if speed.shed else 1.0,
            turning=min(_TURNS[turn.shed + 1], 1.0) if turn.shed else 1.0,
            disturbance=max(self._slip.rate - stated.disturbance, 0.0) + excess,
        )
        self._prove()
        self.model = self.grown.beside(self.unproven).of(stated)
        limit = _LARGEST_SLIP * max(stated.speed, stated.reverse_speed)
        for lost, what in (
            (self._speed.lost, "brakes less, later or drives faster"),
            (self._turn.lost, "stops turning later or turns faster"),
            (self.grown.disturbance > limit, "moves elsewhere than its odometry's speeds say, more"),
        ):
            if lost:
                self.problem = _LOST.format(what)
                return
        self.problem = _PUSHED if self._pushed else ""

    def _prove(self) -> None:
        """Drop the margins for properties that the robot has demonstrated."""
        unproven = self.unproven
        if unproven == Bounds():
            return
        # A later start with more acceleration than was ever seen is not reckoned with.
        speed, turn = self._speed.open()[:, : self._speed.grown.build + 1], self._turn.open()
        later = np.asarray(speed.any(axis=(1, 2)) & turn.any(axis=(1, 2)))
        within = [_UNSEEN_DELAY + 1e-9 < each <= unproven.delay + 1e-9 for each in LATER]
        weaker = np.asarray(speed.any(axis=(0, 1)))
        lows = [min(each, 1.0) for each in _SHEDS[1:]]
        some = [
            unproven.braking - 0.05 <= low and high <= _UNSEEN_BRAKING for low, high in zip(lows, _SHEDS, strict=False)
        ]
        if unproven.delay > 0.0 and not later[within].any():
            self.unproven = unproven = Bounds(braking=unproven.braking)
        if unproven.braking < 1.0 and not weaker[some].any():
            self.unproven = Bounds(delay=unproven.delay)
