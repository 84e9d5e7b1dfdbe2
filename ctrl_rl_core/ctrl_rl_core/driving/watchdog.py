"""Decides when a robot receives its commands and when it receives zero. No ROS; steady time is an argument."""

from __future__ import annotations


class Watchdog:
    """Forwards commands while they keep coming, and requests zeros once they stop.

    It starts silent, because the robot may still hold a command of a dead watchdog. If `tick` was not called for longer
    than the time-out, this process itself was frozen and any command received meanwhile is old, so commands are ignored
    for the first period afterwards.

    Attributes:
        silent: Whether zeros replace commands.
        overslept: Number of times this process was frozen for longer than the time-out.
    """

    def __init__(self, now: float, timeout: float, period: float, repeat_for: float) -> None:
        """Start at a steady time `now` [s].

        Args:
            now: Steady time [s].
            timeout: Age of the last command after which the robot stops [s].
            period: Interval between calls of `tick` [s].
            repeat_for: Time for which zeros are repeated [s]; 0 for the whole silence.
        """
        self._timeout, self._period, self._repeat_for = timeout, period, repeat_for
        self._passed_at: float | None = None
        self._ticked_at = self._silent_since = now
        self._deaf_until = now
        self.silent, self.overslept = True, 0

    def passes(self, now: float) -> bool:
        """Return whether a valid command that arrives now may be forwarded; if not, send zero."""
        self._notice_freeze(now)
        if now < self._deaf_until:
            return False
        self._passed_at, self.silent = now, False
        return True

    def tick(self, now: float) -> bool:
        """Return whether a zero is due; call once per period."""
        self._notice_freeze(now)
        self._ticked_at = now
        if not self.silent and self._passed_at is not None and now - self._passed_at > self._timeout:
            self._fall_silent(now)
        return self.silent and (self._repeat_for == 0.0 or now - self._silent_since <= self._repeat_for)

    def silent_for(self, now: float) -> float | None:
        """Return the age of the last forwarded command [s]; None before the first."""
        return None if self._passed_at is None else now - self._passed_at

    def _notice_freeze(self, now: float) -> None:
        if now - self._ticked_at <= self._timeout:
            return
        self.overslept += 1
        self._ticked_at, self._deaf_until = now, now + self._period
        self._fall_silent(now)

    def _fall_silent(self, now: float) -> None:
        self.silent, self._silent_since = True, now
