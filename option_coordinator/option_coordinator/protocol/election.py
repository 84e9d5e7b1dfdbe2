"""Leader election: among connected coordinators, the one with the highest epoch decides. No ROS, no clock.

A listener takes over after a lease without a decider, in an epoch above all it has seen. A decider announces itself
several times per lease, and returns to listening when it sees a higher epoch.

If messages arrive within a lease, exactly one decider remains, regardless of the number of coordinators and their start
times: all deciders but the highest step down when they hear it, no listener that hears it takes over, and no higher
epoch appears, because only a take-over creates one. A dead decider is replaced after a lease. Only a lease of silence
proves that others are absent, since the middleware's knowledge of its peers can be seconds old.
"""

from __future__ import annotations

import numpy as np

_HEARTBEATS_PER_LEASE = 5
_LOT_BITS = 32
_RISE = 16 << _LOT_BITS
_LARGEST_LEAP = 1 << 61
_LIMIT = 1 << 62
_CANDIDATES = 16


class Epochs:
    """Tracks the highest trusted epoch, so that one corrupt message cannot raise it beyond every coordinator's reach.

    A rise by up to 16 take-overs is accepted at once, as is the first epoch received. A larger jump is accepted after
    the same epoch has been received for a lease, because a coordinator repeats its epoch several times per lease.

    Args:
        lease: Time for which a larger jump must be reported [s].

    Attributes:
        highest: Highest accepted epoch; 0 for none.
        refused: Number of rejected epochs.
    """

    def __init__(self, lease: float) -> None:
        self._lease = lease
        self.highest = self.refused = 0
        self._leaps: dict[int, tuple[float, float]] = {}

    def believe(self, epoch: int, now: float) -> bool:
        """Return whether an epoch is accepted; if so, update the highest one."""
        if epoch <= self.highest:
            return True
        near = epoch <= self.highest + _RISE or (self.highest == 0 and epoch < _LARGEST_LEAP)
        if epoch < _LIMIT and (near or (epoch < _LARGEST_LEAP and self._lasts(epoch, now))):
            self.highest = epoch
            self._leaps.clear()
            return True
        self.refused += 1
        return False

    def _lasts(self, epoch: int, now: float) -> bool:
        """Return whether an epoch jump was reported continuously for one lease."""
        first, last = self._leaps.pop(epoch, (now, now))
        if now - last > self._lease:
            first = now
        if len(self._leaps) >= _CANDIDATES:
            del self._leaps[next(iter(self._leaps))]  # received longest ago
        self._leaps[epoch] = (first, now)
        return now - first >= self._lease


class Election:
    """One coordinator's part in the election. Times are in seconds of a steady clock.

    Args:
        now: Time at which listening starts [s].
        lease: Listening time before a take-over [s].
        seed: Seed of the random bits that distinguish the epochs of simultaneous take-overs.

    Attributes:
        epoch: Epoch in which this coordinator decides; 0 while listening.
        stands_by: Whether another coordinator decides.
        seen: Epochs received so far.
    """

    def __init__(self, now: float, lease: float, seed: int | None = None) -> None:
        self._lease = lease
        self._random = np.random.default_rng(seed)
        self.seen = Epochs(lease)
        self._heartbeat_at = now
        self.listen(now)

    def listen(self, now: float) -> None:
        """Listen for a lease before deciding again."""
        self.epoch, self.stands_by = 0, False
        self._takes_over_at = now + self._lease

    def on_epoch(self, epoch: int, now: float) -> bool:
        """Record an epoch seen by another participant; return whether this coordinator must step down."""
        if not self.seen.believe(epoch, now) or not 0 < self.epoch < epoch:
            return False
        self.listen(now)
        return True

    def on_coordinator_heartbeat(self, epoch: int, now: float) -> bool:
        """Record another decider; return whether this one must step down. Epochs below the highest are ignored."""
        down = self.on_epoch(epoch, now)
        if not self.epoch and epoch == self.seen.highest:
            self.listen(now)
            self.stands_by = True
        return down

    def tick(self, now: float, ready: bool = True) -> bool:
        """Advance time; return whether a heartbeat is due. A coordinator that is not `ready` keeps listening."""
        if not self.epoch and ready and now >= self._takes_over_at:
            self.epoch = self.seen.highest = self._next_epoch()
            self.stands_by = False
            self._heartbeat_at = now
        if not self.epoch or now < self._heartbeat_at:
            return False
        self._heartbeat_at = now + self._lease / _HEARTBEATS_PER_LEASE
        return True

    def _next_epoch(self) -> int:
        """Return an epoch above the highest: the upper bits count up, the lower 32 are random.

        Two simultaneous take-overs have seen the same epochs; with plain counting both would decide in the same new
        one.
        """
        return ((self.seen.highest >> _LOT_BITS) + 1 << _LOT_BITS) + int(self._random.integers(1 << _LOT_BITS))
