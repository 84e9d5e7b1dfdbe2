"""The end of a drive: its episode has an outcome, or the robot has gone as far as it may. Pure logic."""

from __future__ import annotations

import math

from ctrl_rl_core.tasks.outcome import Outcome

ENDED = "the drive is over: "
"""First words of every reason of this module."""
_LONGEST_STEP_S = 1.0
_NOISE, _LEAP = 0.02, 1.0
"""Way of a pose that may be noise, and from which on it has another origin instead [m]."""


class Arrival:
    """Tells why a robot that has arrived must stand.

    Attributes:
        max_distance: Distance after which the robot stands [m]; 0 for none.
        travelled: Distance by odometry since the drive began, the larger of its pose's and its twist's [m].
    """

    def __init__(self, max_distance: float) -> None:
        """Begin a drive."""
        self.max_distance = max_distance
        self._outcome = Outcome.RUNNING
        self._episode: int | None = None
        self._last = math.nan
        self._place: tuple[float, float] | None = None
        self.begin()

    def begin(self) -> None:
        """Count the distance from here."""
        self.travelled = self._by_pose = self._by_twist = 0.0

    def episode(self, number: int, outcome: int) -> None:
        """Note number and outcome of an episode, as in EpisodeStatus; a new episode begins a new drive."""
        known = {value.value for value in Outcome}
        new = Outcome(outcome) if outcome in known else Outcome.RUNNING
        if number != self._episode or (new is Outcome.RUNNING and self._outcome is not Outcome.RUNNING):
            self.begin()
        self._episode, self._outcome = number, new

    def moved(self, now: float, speed: float) -> None:
        """Note the speed [m/s] by odometry at the time of a scan [s]; gaps longer than a second do not count."""
        step = now - self._last
        self._last = now
        if 0.0 < step <= _LONGEST_STEP_S and math.isfinite(speed):
            self._by_twist += abs(speed) * step
            self.travelled = max(self._by_pose, self._by_twist)

    def went(self, x: float, y: float) -> None:
        """Note a position by odometry [m]: some bases publish a right pose and a twist of zero."""
        step = math.dist(self._place or (x, y), (x, y))
        if self._place is not None and step < _NOISE:
            return
        self._place = (x, y)
        if step < _LEAP:
            self._by_pose += step
            self.travelled = max(self._by_pose, self._by_twist)

    def reason(self) -> str:
        """Return why the robot must stand, empty while the drive goes on."""
        if self._outcome is not Outcome.RUNNING:
            return f"{ENDED}{self._outcome.words} (episode {self._episode})"
        if 0.0 < self.max_distance <= self.travelled:
            return f"{ENDED}{self.max_distance:g} m driven (parameter max_distance; set it anew to go on)"
        return ""
