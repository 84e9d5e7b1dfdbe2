"""Tracks what moves in the scans of a lidar: position and velocity with their uncertainty, in the odometry frame.

Neighbouring echoes form a group. A small group is a disc with a Kalman filter of constant velocity. A disc moves if it
is where beams passed through a moment ago, or if beams pass through where it was: neither happens to what stands, from
wherever it is seen. A disc that something hides goes on at its velocity until beams pass through its place.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ctrl_rl_navigation.people.groups import Disc, discs_of
from ctrl_rl_navigation.people.habits import Walk, expected
from ctrl_rl_navigation.people.movers import COLUMNS, NOBODY, mover
from ctrl_rl_navigation.people.seen_free import SeenFree

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_NOISE, _PARTLY = 0.03, 0.12
"""Standard deviations of a disc's measured centre [m]: as a rule, and where something hides a part of it."""
_UNSTEADY = 0.05
"""Power density of the acceleration of people [m^2/s^3]."""
_AT_FIRST = 0.6
"""Standard deviation of the velocity of a disc at first sight [m/s]."""
_GATE, _NEAREST, _FARTHEST = 3.5, 0.35, 0.8
"""Difference between measured and predicted place up to which they are one disc: standard deviations, but from some
metres up to others; people turn back at once."""
_WINDOW = 1.0
"""Time over which places are compared [s]."""
_BACKGROUND, _SPACING = 8.0, 0.5
"""Time over which echoes are told from those of walls behind them, and between the scans kept for it [s]."""
_SHARE = 0.4
"""Share of a disc's echoes that must have changed place."""
_SLOWEST = 0.1
"""Speed below which a disc is not called moving [m/s]."""
_VOTES = 2
"""Number of scans in which a disc must have changed place before it counts as moving."""
_SLOWS = 0.7
"""Share of its pace below which a disc may be about to stop."""
_HALTS = 0.5
"""Share of its pace below which it has stopped."""
_PACED = 2.0
"""Time after which a slower pace is a new one [s]."""
_RESUMES = 6.0
"""Time for which one that stopped may go on or turn back [s]; then it is an obstacle like others."""
_STAYS = 0.4
"""Probability that it does neither."""
_HIDDEN = 4.0
"""Time for which a hidden mover is remembered [s]."""
_GONE = 3
"""Number of scans that must have looked through a disc's place before it is dropped."""
_WALKS = 12
"""Number of walks that are remembered of those who have gone."""
_SMOOTH = 0.3
"""Weight of a new measurement of a radius."""


@dataclass
class Track:
    """A tracked disc.

    Attributes:
        state: Position and velocity (2, 2) [m], [m/s].
        covariance: Covariance of position and velocity of either axis (2, 2).
        radius: Radius [m].
        at: Time of the state [s].
        seen_at: Time of the last measurement [s].
        moved_at: Time of the last change of place [s].
        pace: Velocity before it slowed down (2,) [m/s].
        paced_at: Time of that [s].
        walk: Its places so far.
    """

    state: Array
    covariance: Array
    radius: float
    at: float
    seen_at: float
    moved_at: float = -math.inf
    pace: Array = field(default_factory=lambda: np.zeros(2))
    paced_at: float = -math.inf
    votes: int = 0
    misses: int = 0
    echoes: deque[tuple[float, Array, float]] = field(default_factory=deque)
    walk: Walk = field(default_factory=Walk)

    def advance(self, now: float) -> None:
        """Predict the state at a time [s]."""
        dt = now - self.at
        self.at = now
        self.state[0] += dt * self.state[1]
        move = np.array(((1.0, dt), (0.0, 1.0)))
        noise = _UNSTEADY * np.array(((dt**3 / 3.0, dt**2 / 2.0), (dt**2 / 2.0, dt)))
        self.covariance = move @ self.covariance @ move.T + noise

    def take(self, now: float, disc: Disc, turned: float) -> None:
        """Correct the state by a measurement, after the robot has turned by some angle in all [rad]."""
        noise = _PARTLY if disc.partly else _NOISE
        error = disc.centre(self.radius) - self.state[0]
        if error @ error > _GATE**2 * (self.covariance[0, 0] + noise**2):  # it turned or stopped: its velocity is new
            self.covariance = self.covariance + np.diag((0.0, _AT_FIRST**2))
            self.covariance[0, 0] += float(error @ error)
        gain = self.covariance[:, 0] / (self.covariance[0, 0] + noise**2)
        self.state = self.state + np.outer(gain, error)
        self.covariance = self.covariance - np.outer(gain, self.covariance[0])
        if not disc.partly or disc.radius > self.radius:
            self.radius += _SMOOTH * (disc.radius - self.radius)
        self.seen_at, self.misses = now, 0
        self.walk.note(now, self.state[0])
        self.echoes.append((now, disc.echoes, turned))
        while now - self.echoes[0][0] > _WINDOW:
            self.echoes.popleft()

    def watch(self, now: float, changed: bool) -> None:
        """Note whether the disc has changed place."""
        self.votes = min(self.votes + 1, _VOTES) if changed else max(self.votes - 1, 0)
        speed = math.hypot(*self.state[1])
        if changed and self.votes >= _VOTES and speed >= _SLOWEST:
            self.moved_at = now
            if speed > _SLOWS * math.hypot(*self.pace) or now - self.paced_at > _PACED:
                self.paced_at, self.pace = now, self.state[1].copy()

    @property
    def is_mover(self) -> bool:
        """Return whether it moves, or may go on soon."""
        return self.seen_at - self.moved_at < _RESUMES

    def rows(self, now: float, others: Iterable[Walk] = ()) -> Array:
        """Return the predictions of a mover (n, 12), see `movers`; none for what stands.

        Args:
            now: Time of the predictions [s].
            others: Walks of others, who may have had the same way.
        """
        if not self.is_mover:
            return NOBODY
        unlike, habits = expected(self.walk, others, now, self.radius)
        spreads = (self.covariance[0, 0], self.covariance[0, 1], self.covariance[1, 1])
        if math.hypot(*self.state[1]) > _HALTS * math.hypot(*self.pace):
            rows = [mover(self.state[0], self.state[1], self.radius, spreads, unlike)]
        else:  # One that stops may stay, go on or turn back.
            ways = ((self.state[1], _STAYS), (self.pace, 0.5 * (1.0 - _STAYS)), (-self.pace, 0.5 * (1.0 - _STAYS)))
            rows = [mover(self.state[0], velocity, self.radius, spreads, unlike * share) for velocity, share in ways]
        return np.concatenate((rows, habits))


class Tracker:
    """Tracks the movers around one robot."""

    def __init__(self) -> None:
        self._tracks: list[Track] = []
        self._gone: deque[Walk] = deque(maxlen=_WALKS)
        self._free: deque[SeenFree] = deque()
        self._background: deque[SeenFree] = deque()
        self._now, self._turned, self._heading = -math.inf, 0.0, 0.0

    def movers(self) -> Array:
        """Return the predictions of all movers (m, 12), see `movers`, at the time of the last scan."""
        walks = [*(track.walk for track in self._tracks), *self._gone]
        walks = [walk for walk in walks if walk.went_away]
        rows = [track.rows(self._now, [walk for walk in walks if walk is not track.walk]) for track in self._tracks]
        return np.concatenate(rows) if rows else np.empty((0, COLUMNS))

    def update(self, now: float, origin: Array, ends: Array, echoes: Mask, heading: float = 0.0) -> Mask:
        """Process a scan, and return which of its echoes are those of movers (number of echoes,).

        Args:
            now: Steady time [s]; a scan that is not newer than the last one starts anew.
            origin: Position of the lidar (2,) [m].
            ends: End points of the beams, in beam order (n, 2) [m]; that of a beam without a measurement lies close to
                the lidar.
            echoes: Whether each beam hit something (n,).
            heading: Heading of the robot by its odometry [rad].
        """
        if now <= self._now:
            self._tracks, self._free, self._background = [], deque(), deque()
            self._gone.clear()
        self._turned += abs(math.remainder(heading - self._heading, 2.0 * math.pi))
        self._now, self._heading = now, heading
        free = SeenFree(now, origin, ends, self._turned)
        self._free.append(free)
        while now - self._free[0].time > _WINDOW:
            self._free.popleft()
        points = ends[echoes]
        fresh = np.zeros(len(points), np.bool_)
        for each in self._background:
            fresh |= each.shows_free(points, turned=self._turned)
        self._keep(free)
        moves = np.zeros(len(points), np.bool_)
        for track, disc in self._assign(now, discs_of(origin, ends, echoes, fresh)):
            track.take(now, disc, self._turned)
            track.watch(now, self._changed(track, disc, free))
            moves[disc.members] = track.is_mover
        self._drop(now, free)
        return moves

    def _keep(self, free: SeenFree) -> None:
        """Keep a scan now and then, in which walls are seen behind people."""
        if not self._background or free.time - self._background[-1].time >= _SPACING:
            self._background.append(free)
        while free.time - self._background[0].time > _BACKGROUND:
            self._background.popleft()

    def _assign(self, now: float, discs: list[Disc]) -> list[tuple[Track, Disc]]:
        """Return each disc with its track, a new one if none is near enough."""
        for track in self._tracks:
            track.advance(now)
        known = np.array([track.state[0] for track in self._tracks]).reshape(-1, 2)
        found = np.array([disc.centre(disc.radius) for disc in discs]).reshape(-1, 2)
        noise = np.array([_PARTLY if disc.partly else _NOISE for disc in discs])
        variance = np.array([track.covariance[0, 0] for track in self._tracks])
        away = np.linalg.norm(known[:, None] - found, axis=2)
        cost = away / np.sqrt(variance[:, None] + noise**2)
        outside = (away > _FARTHEST) | ((cost > _GATE) & (away > _NEAREST))
        pairs = []
        left = set(range(len(discs)))
        for i, j in zip(*linear_sum_assignment(np.where(outside, 1e3, cost)), strict=True):
            if not outside[i, j]:
                pairs.append((self._tracks[i], discs[j]))
                left.discard(int(j))
        for new in sorted(left):
            state = np.array((found[new], (0.0, 0.0)))
            track = Track(state, np.diag((_NOISE**2, _AT_FIRST**2)), discs[new].radius, now, now)
            self._tracks.append(track)
            pairs.append((track, discs[new]))
        return pairs

    def _changed(self, track: Track, disc: Disc, free: SeenFree) -> bool:
        """Return whether a disc is where beams passed a moment ago, or beams pass where it was."""
        came = self._free[0].shows_free(disc.echoes, turned=self._turned).mean()
        _, echoes, turned = track.echoes[0]
        left = free.shows_free(echoes, turned=turned).mean()
        return bool(max(came, left) >= _SHARE)

    def _drop(self, now: float, free: SeenFree) -> None:
        """Forget discs that have gone, and what has been hidden for long."""
        kept = []
        for track in self._tracks:
            if track.seen_at < now:
                track.misses += bool(free.shows_free(track.state[:1], track.radius)[0])
                lasts = _HIDDEN if track.is_mover else _WINDOW
                if track.misses >= _GONE or now - track.seen_at > lasts:
                    if track.walk.went_away:
                        self._gone.append(track.walk)
                    continue
            kept.append(track)
        self._tracks = kept
