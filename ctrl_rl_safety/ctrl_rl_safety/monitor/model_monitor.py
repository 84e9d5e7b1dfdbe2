"""Predicts the robot's motion from its commands, and compares it with the measured one all the time.

The bounds of the model grow at the first measurement that they do not allow, and a robot that is worse than any bound
stands. Before the robot has shown that it brakes as stated and at once, some braking and some delay are not relied on.
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
"""The same of the turn acceleration."""
_ERRORS = 0.02, 0.05
"""Errors of a measured speed [m/s] and turn rate [rad/s] near zero."""
_SLACK = 0.1
"""Fraction of its largest speed by which a robot may exceed every command, as on a slope."""
_TURN_SLACK, _LEAST_TURN_SLACK = 0.2, 0.3
"""The same of its turn rate, which shakes as wheels slip, and the least that is borne [rad/s]."""
_UNSEEN_DELAY = 0.06
"""Delay beyond the stated one that a start does not reveal [s]."""
_UNSEEN_BRAKING = 0.87
"""Braking relative to the stated one that no stop tells from it."""
_LONGEST = 0.3
"""Longest interval between two measurements that are compared [s]."""
_ANY = (-np.inf, -UNKNOWN, UNKNOWN, -UNKNOWN, UNKNOWN)
"""Time of any command before the first one, and its lowest and highest speed and turn rate."""
_KEPT = 1.5
"""Time beyond the stated delay for which commands are kept [s]; the longest delay and the longest interval."""
_LARGEST_SLIP = 0.5
"""Disturbance that a robot may have at most, as a fraction of its speed."""
_PUSHED = "the robot moves although it is told to stand: is it pushed, or does somebody else command it?"
_LOST = "the robot {} than any bound allows: measure it with `identify`, mend it, then start the filter again"


class ModelMonitor:
    """Bounds of a robot's motion that hold for all that was seen of it.

    Args:
        stated: Model of the robot.
        unproven_braking: Fraction of the braking not relied on before the robot has shown it.
        unproven_delay: Delay beyond the stated one that is reckoned with before the robot has shown to be quicker [s].

    Attributes:
        stated: Model of the robot.
        model: The same with the bounds that hold now.
        grown: What the robot was seen to do worse than stated.
        unproven: What it has not been seen to do as stated.
        problem: Reason for which the robot must stand; empty for none.
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
        """Begin again, because time or the odometry frame has jumped; bounds that have grown stay."""
        self._slip.forget()
        self._last = None
        self._sent.clear()
        self._sent.append(_ANY)

    def measure(self, time: float, pose: Array, v: float, omega: float) -> None:
        """Judge the motion; from then on `model` holds.

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
        changes = [self.stated.track > 0.0 and most - least > STANDS for least, most in told]
        known, any_ = self._turn.grown.delay, np.ones(len(LATER), np.bool_)
        self._speed.measure(speeds, last[0], time, v, changes[1], known, any_)
        # Turn rates shake as wheels slip: what the speed has shown of the delay counts for more.
        known, possible = self._speed.grown.delay, self._speed.delays
        self._turn.measure(turns, last[0], time, omega, changes[0], known, possible)
        self._use()

    def _moved_by_others(self, told: tuple[tuple[float, float], ...], stands: bool) -> bool:
        """Return whether a robot that stood moves although no command says so, until it stands again."""
        if max(abs(each) for both in told for each in both) >= STANDS:
            self._rested = self._pushed = False
        elif stands:
            self._rested, self._pushed = True, False
        elif self._rested:
            self._pushed = True
        return self._pushed

    def _use(self) -> None:
        """Take the bounds from what was seen."""
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
        """Rely on what the robot has shown."""
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
