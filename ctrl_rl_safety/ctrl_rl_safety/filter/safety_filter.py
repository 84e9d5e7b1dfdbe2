"""Answers raw commands with certified ones; steady time is an argument. No ROS.

safety = SafetyFilter(find_model("turtlebot3_burger"))
safety.see(now, pose, echoes)
safety.use(safety.solve())      # in a thread; without it only constant-turn-rate escapes are used
verdict = safety.decide(now, Reading(pose, v, omega), raw)
safety.sent(now, verdict.command)
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.filter.answer import PASSED, Answer, Request, answer
from ctrl_rl_safety.filter.certificate import FAMILY, MOST_STEPS, escape_path
from ctrl_rl_safety.filter.echoes import SAME, EchoMemory, moved, surfaces, thinned
from ctrl_rl_safety.filter.evading import AHEAD, LONGER, evade
from ctrl_rl_safety.filter.evidence import Beams, EchoEvidence, beams_from, kinds_of
from ctrl_rl_safety.filter.local_grid import grid_around
from ctrl_rl_safety.filter.map_walls import Fixed
from ctrl_rl_safety.filter.seen_space import SeenSpace, Sight
from ctrl_rl_safety.filter.situation import NO_GUIDE, Guide, Situation
from ctrl_rl_safety.filter.unblocking import Unblocking
from ctrl_rl_safety.filter.verdict import FilterOptions, Mode, Reading, Verdict
from ctrl_rl_safety.filter.walls import Walls
from ctrl_rl_safety.models.growth import Growth, unnoticed_speed
from ctrl_rl_safety.models.motion import STANDS, motion_of
from ctrl_rl_safety.models.robot_model import RobotModel
from ctrl_rl_safety.sets.distance_field import NONE, Obstacles, obstacles_around
from ctrl_rl_safety.sets.recoverable_set import RecoverableSet, solve_set

Array = NDArray[np.float64]

STEP = 0.02
"""Time step of the roll-outs [s]."""
_LAGS = 6.0
"""Maximum duration of the end of a braking manoeuvre, in time constants of the exponential decay."""
_LATE = 0.06
"""Maximum delay of a scan beyond its usual interval [s]."""
_LONGEST_INTERVAL = 0.5
"""Maximum scan interval for which a corrected command waits [s]."""
_UNBLOCKING = 0.3
"""Fraction of the maximum turn rate used for unblocking."""
_SIDE = 0.25
"""Spacing of the points on a surface relative to the radius: a disc dips in by less than 1 % of its radius."""
_LEAST_SIDE = 0.02
"""Minimum spacing of these points [m]."""
_SET_AGE = 0.5
"""Maximum age of a set used to choose escapes [s]."""


class SafetyFilter:
    """Keeps one robot in its recoverable set.

    Attributes:
        model: Robot model.
        options: Settings of the filter.
        reach: Distance from the robot within which echoes are used [m].
    """

    def __init__(self, model: RobotModel, options: FilterOptions | None = None) -> None:
        """Start without a scan.

        Raises:
            SafetyError: The robot brakes too slowly for a certificate to cover its stop.
        """
        self.options = value = options or FilterOptions()
        self.reach = 0.0
        self._use_model(model)
        self._soonest = model.delay
        self._hold = max(1, math.ceil(value.period / STEP))
        # A corner of a rectangle may dip into a surface by half the spacing of its points.
        self._side = max(model.range_error if model.length else _SIDE * model.radius, _LEAST_SIDE)
        self._memory = EchoMemory(value.standing_time)
        self._evidence = EchoEvidence(model, self.reach)
        self._space = SeenSpace(self.reach, model.radius) if value.unseen == "obstacle" else None
        self._walls = Walls(value.mover_size) if value.mover_size > 0.0 else None
        self._unblocking = Unblocking(value.unblock_after)
        self._seen: tuple[Obstacles, float] | None = None
        self._set: RecoverableSet | None = None
        self._arrived, self._interval = -math.inf, 0.0
        self._sent: deque[tuple[float, float, float]] = deque(maxlen=1000)
        self._corrected, self._headed = False, 0.0
        self._kind, self._evading = 0, False
        self._last_v = 0.0
        self._certified: tuple[float, Verdict, Situation] | None = None

    def adopt(self, model: RobotModel, soonest: float | None = None) -> None:
        """Use a model of the same robot with other bounds of its motion from the next command and set on.

        Args:
            model: The model, whose delay is the longest that the robot may have.
            soonest: The shortest delay that it may have [s]; the model's by default.

        Raises:
            SafetyError: The robot brakes too slowly for a certificate to cover its stop.
        """
        if model != self.model:
            self._use_model(model)
        self._soonest = model.delay if soonest is None else min(soonest, model.delay)

    def _use_model(self, model: RobotModel) -> None:
        """Compute what follows from a model, which takes longer than an odometry message may."""
        braking = max(model.speed, model.reverse_speed) / model.braking + _LAGS * model.lag
        if braking > STEP * MOST_STEPS:
            raise SafetyError(f"{model.name} takes {braking:.0f} s to brake: at most {STEP * MOST_STEPS:.0f} s")
        value = self.options
        begun = unnoticed_speed(SAME + 2.0 * model.range_error, value.standing_time, value.mover_acceleration)
        self.model, self._motion = model, motion_of(model, STEP)
        self._growth = Growth(model.disturbance, value.mover_speed, value.mover_acceleration, begun)
        self._cell, reach = grid_around(model, value)
        self.reach = max(self.reach, reach)

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
        """Process a scan.

        Args:
            now: Steady time [s].
            pose: Pose of the robot at the time of the scan, in the odometry frame (3,) [m, m, rad].
            echoes: Echoes in the robot's frame at that time, in beam order (n, 2) [m].
            age: Age of the scan [s].
            fixed: Returns which positions (n, 2) in the odometry frame [m] are occupied on a map and thus never move
                (n,); None without a map.
            sight: Free range of the scan in each direction, required by `unseen`.
            beams: Beams of the scan with and without echo; by default a dense scan all around, with these echoes.

        Raises:
            SafetyError: Unseen space counts as an obstacle, but `sight` is missing.
        """
        self._interval = min(max(now - self._arrived, 0.0), _LONGEST_INTERVAL)
        self._arrived = now
        near = thinned(echoes[np.hypot(echoes[:, 0], echoes[:, 1]) < self.reach])
        widest = 2.0 * self.model.half_width
        held = self._evidence.look(now, pose, beams_from(echoes, widest) if beams is None else beams)
        places, before, edges = surfaces(near, self._side, widest)
        places, standing = moved(places, pose), NONE
        moving = moved(edges, pose) if self.options.occluded_movers else NONE
        known = stays = np.ones(len(places), np.bool_)
        fresh = places[: len(near)]
        if self.options.mover_speed > 0.0:
            known = self._memory.update(now, places)
            stays = np.zeros(len(places), np.bool_) if fixed is None else fixed(places)
            if self._walls is not None:
                wall = self._walls.update(now, places[: len(near)], known[: len(near)])
                stays |= np.concatenate((wall, wall[before] & wall[(before + 1) % max(len(near), 1)]))
            moving = np.concatenate((moving, places[~known & ~stays]))
            places, standing = places[stays], places[known & ~stays]
        places, standing, moving = held.beside((places, standing, moving), fresh, self.options.mover_speed, SAME)
        self._evidence.note(now, fresh, kinds_of(known, stays)[: len(near)])
        if self._space is not None:
            if sight is None:
                raise SafetyError("unseen space counts as an obstacle: give the free range of the scan")
            places = np.concatenate((places, self._space.update(pose, sight)))
        if self._evidence.awaited:
            return
        obstacles = obstacles_around(places, standing, moving, (float(pose[0]), float(pose[1])), self._cell)
        self._seen = obstacles, now - age - self.model.scan_age

    def solve(self) -> RecoverableSet | None:
        """Return the recoverable set of the last scan; None before the first scan. May run in another thread."""
        if self._seen is None:
            return None
        obstacles, seen_at = self._seen
        commit = self.model.delay + self.options.period
        return solve_set(obstacles, self.model, self._growth, self.model.scan_age, self._last_v, commit, stamp=seen_at)

    def use(self, found: RecoverableSet | None) -> None:
        """Use a set for escapes from now on; None for constant-turn-rate escapes only."""
        self._set = found

    @property
    def obstacles(self) -> Obstacles | None:
        """Echoes of the last scan; None before the first scan."""
        return None if self._seen is None else self._seen[0]

    @property
    def recoverable(self) -> RecoverableSet | None:
        """The set in use."""
        return self._set

    def forget(self) -> None:
        """Discard scans and set, because the odometry frame has jumped; several new scans are needed from now on."""
        for each in (self._memory, self._evidence, self._space, self._walls):
            if each is not None:
                each.clear()
        self._set = self._seen = self._certified = None

    def sent(self, now: float, command: Array) -> None:
        """Record a command (2,) that was sent to the robot."""
        self._sent.append((now, float(command[0]), float(command[1])))

    def decide(self, now: float, reading: Reading, raw: Array) -> Verdict:
        """Return the command to send in place of a raw one (2,) [m/s, rad/s].

        Raises:
            SafetyError: No scan has been received.
        """
        if self._seen is None:
            raise SafetyError("no scan yet")
        obstacles, seen_at = self._seen
        self._last_v = reading.v
        (slowest, least_turn), (fastest, most_turn) = self.model.limits
        wanted = (min(max(float(raw[0]), slowest), fastest), min(max(float(raw[1]), least_turn), most_turn))
        state = np.array((*reading.pose, reading.v, reading.omega))
        if not self._corrected:
            self._headed = float(reading.pose[2])
        still = np.concatenate((obstacles.fixed, obstacles.standing), axis=1)
        room = self.model.half_width + self.model.range_error
        turn = _UNBLOCKING * most_turn * self._unblocking.turn(now, wanted, state, still, room)
        ask = Request(
            wanted,
            self._sent[-1][1:] if self._sent else (0.0, 0.0),
            self._corrected,
            turn,
            self.options.hysteresis,
            self._patience(now),
            self._kind,
            slowest,
            fastest,
            self.model.acceleration,
            self.model.braking,
            self.model.turn_acceleration,
            math.remainder(state[2] - self._headed, 2.0 * math.pi),
            math.nan if self._certified is None else float(self.stopping(now)[1]),
            2.0 * self.model.range_error,
        )
        age = now - reading.age - seen_at
        situation = self._situation(now, obstacles)
        under_way = self._under_way(now, reading.age, self.model.delay)
        known = self._soonest == self.model.delay
        sooner = under_way if known else self._under_way(now, reading.age, self._soonest)
        found = Answer(*answer(situation, ask, state, age, under_way, sooner))
        if self.options.evade and abs(found.v) < STANDS:
            ahead = LONGER if self._evading else AHEAD
            v, omega, margin, kind = evade(
                situation, found.state, age + STEP * len(under_way), (slowest, fastest), ahead
            )
            if margin >= 0.0:
                found = found._replace(v=v, omega=omega, mode=Mode.EVADING, margin=margin, kind=kind)
        self._evading = found.mode == Mode.EVADING
        # An escape by the set takes longest, so it is tried after constant turn rates.
        self._corrected, self._kind = found.mode != PASSED, found.kind % FAMILY
        self._unblocking.note(now, (found.v, found.omega), wanted, reading.v)
        command = np.array((found.v, found.omega))
        verdict = Verdict(command, Mode(found.mode), found.margin, found.value, np.array(found.state), found.kind)
        if found.margin >= 0.0:
            self._certified = now, verdict, situation
        return verdict

    def escape(self, verdict: Verdict) -> Array:
        """Return the states (n, 5) of a verdict's command and of its certified escape, for plotting."""
        if self._seen is None:
            return np.empty((0, 5))
        return _path(self._situation(self._seen[1], self._seen[0]), verdict)

    def stopping(self, now: float) -> Array:
        """Return the command (2,) of the last certified escape at a steady time [s], for use without current data."""
        if self._certified is None:
            return np.zeros(2)
        begun, verdict, situation = self._certified
        place = max(math.floor((now - begun) / STEP), self._hold)
        path = _path(situation, verdict)
        return np.array((0.0, path[place, 4])) if place < len(path) else np.zeros(2)

    def _situation(self, now: float, obstacles: Obstacles) -> Situation:
        found = self._set
        guide = NO_GUIDE
        if found is not None and now - found.stamp <= _SET_AGE + self.model.scan_age:
            guide = Guide(found.values, found.x, found.y, found.cell, found.top, True)
        return Situation(
            obstacles,
            self._growth,
            self._motion,
            guide,
            self.model.core,
            (self.model.room, self.model.room),
            False,
            self._hold,
            self.model.turn_rate,
            self.model.lag,
        )

    def _patience(self, now: float) -> int:
        """Return the number of time steps until a command after the next scan can take effect."""
        return self._hold + max(math.ceil((self._interval + _LATE - (now - self._arrived)) / STEP), 0)

    def _under_way(self, now: float, age: float, delay: float) -> Array:
        """Return the commands in each time step from the odometry until a new one takes effect (n, 2).

        Args:
            now: Steady time [s].
            age: Age of the odometry [s].
            delay: Delay of the robot [s].
        """
        count = math.ceil((age + delay) / STEP - 1e-9)
        out = np.zeros((count, 2))
        until = count
        for sent_at, v, omega in reversed(self._sent):
            first = max(math.ceil((sent_at + delay - 1e-9 - now + age) / STEP), 0)
            out[first:until] = (v, omega)
            until = min(until, first)
            if until == 0:
                break
        return out


def _path(situation: Situation, verdict: Verdict) -> Array:
    command = (float(verdict.command[0]), float(verdict.command[1]))
    path: Array = escape_path(situation, tuple(verdict.state.tolist()), command, verdict.escape)
    return path
