"""Detects the end of a drive: its episode has an outcome, or the distance limit is reached. No ROS."""

from __future__ import annotations

import math

from ctrl_rl_core.tasks.outcome import Outcome

ENDED = "the drive is over: "
"""Prefix of every reason returned by this module."""
_LONGEST_STEP_S = 1.0
_NOISE, _LEAP = 0.02, 1.0
"""Position change below which motion may be noise, and above which the odometry origin has jumped [m]."""


class Arrival:
    """Decides when a robot must stop because its drive has ended.

    Attributes:
        max_distance: Distance after which the robot stops [m]; 0 for no limit.
        travelled: Distance driven so far [m]: the larger of the pose-based and the twist-based odometry distance.
    """

    def __init__(self, max_distance: float) -> None:
        """Start a drive."""
        self.max_distance = max_distance
        self._outcome = Outcome.RUNNING
        self._episode: int | None = None
        self._last = math.nan
        self._place: tuple[float, float] | None = None
        self.begin()

    def begin(self) -> None:
        """Reset the travelled distance."""
        self.travelled = self._by_pose = self._by_twist = 0.0

    def episode(self, number: int, outcome: int) -> None:
        """Record the number and outcome of an episode, as in EpisodeStatus; a new episode starts a new drive."""
        known = {value.value for value in Outcome}
        new = Outcome(outcome) if outcome in known else Outcome.RUNNING
        if number != self._episode or (new is Outcome.RUNNING and self._outcome is not Outcome.RUNNING):
            self.begin()
        self._episode, self._outcome = number, new

    def moved(self, now: float, speed: float) -> None:
        """Integrate the odometry speed [m/s] at a scan time [s]; gaps longer than one second are skipped."""
        step = now - self._last
        self._last = now
        if 0.0 < step <= _LONGEST_STEP_S and math.isfinite(speed):
            self._by_twist += abs(speed) * step
            self.travelled = max(self._by_pose, self._by_twist)

    def went(self, x: float, y: float) -> None:
        """Add a position from odometry [m]; some bases publish a correct pose with a zero twist."""
        step = math.dist(self._place or (x, y), (x, y))
        if self._place is not None and step < _NOISE:
            return
        self._place = (x, y)
        if step < _LEAP:
            self._by_pose += step
            self.travelled = max(self._by_pose, self._by_twist)

    def reason(self) -> str:
        """Return the reason to stop, or "" while the drive continues."""
        if self._outcome is not Outcome.RUNNING:
            return f"{ENDED}{self._outcome.words} (episode {self._episode})"
        if 0.0 < self.max_distance <= self.travelled:
            return f"{ENDED}{self.max_distance:g} m driven (parameter max_distance; set it anew to go on)"
        return ""
