"""Decides when a robot gets its commands and when it gets zero, without ROS; steady time is an argument."""

from __future__ import annotations


class Watchdog:
    """Lets commands through while they keep coming, and asks for zeros once they do not.

    It begins silent: the robot may still hold the command of a watchdog that died. If `tick` was not called for
    longer than the time-out, this process itself was frozen: a command that waited meanwhile is old, so the first
    period after that is deaf.

    Attributes:
        silent: Whether zeros took the place of commands.
        overslept: Number of times that this process was frozen for longer than the time-out.
    """

    def __init__(self, now: float, timeout: float, period: float, repeat_for: float) -> None:
        """Begin at a steady time `now` [s].

        Args:
            now: Steady time [s].
            timeout: Age of the last command that stops the robot [s].
            period: Time between two calls of `tick` [s].
            repeat_for: Time that zeros repeat [s]; 0 for as long as the input is silent.
        """
        self._timeout, self._period, self._repeat_for = timeout, period, repeat_for
        self._passed_at: float | None = None
        self._ticked_at = self._silent_since = now
        self._deaf_until = now
        self.silent, self.overslept = True, 0

    def passes(self, now: float) -> bool:
        """Return whether a valid command that arrives now may go to the robot; if not, zero is due."""
        self._notice_freeze(now)
        if now < self._deaf_until:
            return False
        self._passed_at, self.silent = now, False
        return True

    def tick(self, now: float) -> bool:
        """Return whether a zero is due; call it once each period."""
        self._notice_freeze(now)
        self._ticked_at = now
        if not self.silent and self._passed_at is not None and now - self._passed_at > self._timeout:
            self._fall_silent(now)
        return self.silent and (self._repeat_for == 0.0 or now - self._silent_since <= self._repeat_for)

    def silent_for(self, now: float) -> float | None:
        """Return the age of the last command that went to the robot [s]; None before the first."""
        return None if self._passed_at is None else now - self._passed_at

    def _notice_freeze(self, now: float) -> None:
        if now - self._ticked_at <= self._timeout:
            return
        self.overslept += 1
        self._ticked_at, self._deaf_until = now, now + self._period
        self._fall_silent(now)

    def _fall_silent(self, now: float) -> None:
        self.silent, self._silent_since = True, now
