"""Guards for callbacks: errors are caught, counted, and logged at a limited rate."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from functools import partial, wraps
from typing import Any

from rclpy.executors import ExternalShutdownException
from rclpy.logging import LoggingSeverity

from ctrl_rl_core.errors import one_line

SAY_EVERY_S = 5.0
"""Minimum wall time between two log lines about the same failing callback [s]."""


class Faults:
    """Records the failures of a node's callbacks.

    Args:
        react: Called with each error; errors it raises are counted too.
        logger: Returns the node's logger.
        fatal: Error classes that end the node.

    Attributes:
        count: Number of failures.
        last: Last failure in one line; empty for none.
        failing: Timers and topics whose latest callback failed.
        ended_by: First fatal error; None for none.
    """

    def __init__(
        self, react: Callable[[Exception], None], logger: Callable[[], Any], fatal: tuple[type[Exception], ...] = ()
    ) -> None:
        self.count = 0
        self.last = ""
        self.failing: set[str] = set()
        self.ended_by: Exception | None = None
        self._react, self._logger, self._fatal = react, logger, fatal
        self._last_at = -float("inf")
        self._said_at: dict[str, float] = {}
        self._unsaid: dict[str, int] = {}

    @property
    def recent(self) -> bool:
        """Whether a callback is failing or has failed within the last few seconds."""
        return bool(self.failing) or time.monotonic() - self._last_at < SAY_EVERY_S

    def guard(self, callback: Callable[..., Any], source: str) -> Callable[..., Any]:
        """Wrap `callback` so that it cannot raise.

        Args:
            callback: Callback of a timer or subscription.
            source: Name of the topic, or "timer".
        """
        name = f"{_name_of(callback)} ({source})"

        @wraps(callback)
        def guarded(*arguments: Any) -> None:
            try:
                callback(*arguments)
            except ExternalShutdownException:
                raise
            except Exception as error:  # the node's other callbacks must keep working
                self.failing.add(name)
                self.note(name, error)
            else:
                if name in self.failing:
                    self.failing.discard(name)

        return guarded

    def guard_service(self, callback: Callable[..., Any], source: str) -> Callable[..., Any]:
        """Wrap a service `callback` so that it cannot raise; a failure returns an empty response.

        If the response has the fields, it reports success = False and the reason.
        """
        name = f"{_name_of(callback)} ({source})"

        @wraps(callback)
        def guarded(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except ExternalShutdownException:
                raise
            except Exception as error:
                self.note(name, error)
                empty = type(response)()
                if isinstance(getattr(empty, "message", None), str):
                    empty.message = one_line(error)
                return empty

        return guarded

    def note(self, name: str, error: Exception) -> None:
        """Count a failure, log it, and react to it."""
        if isinstance(error, self._fatal):
            self.ended_by = self.ended_by or error
            return
        self._record(name, error)
        try:
            self._react(error)
        except Exception as further:
            self._record("on_callback_error", further)

    def _record(self, name: str, error: Exception) -> None:
        now = time.monotonic()
        self.count += 1
        self.last, self._last_at = f"{name}: {one_line(error)}", now
        if now - self._said_at.get(name, -float("inf")) < SAY_EVERY_S:
            self._unsaid[name] = self._unsaid.get(name, 0) + 1
            return
        self._said_at[name] = now
        unsaid = self._unsaid.pop(name, 0)
        more = f" (and {unsaid} times before)" if unsaid else ""
        logger = self._logger()
        logger.error(f"callback failed: {self.last}{more}")
        if logger.is_enabled_for(LoggingSeverity.DEBUG):
            logger.debug("".join(traceback.format_exception(error)))


def _name_of(callback: Callable[..., Any]) -> str:
    while isinstance(callback, partial):
        callback = callback.func
    return str(getattr(callback, "__name__", type(callback).__name__))
