"""Who may move the robot: whoever knows the token; and how often somebody may guess."""

from __future__ import annotations

import hmac
import secrets
import time
from collections import deque
from threading import Lock

from ctrl_rl_core import CtrlRlError

FEWEST_LETTERS = 8
"""Fewest letters of a token that a user chooses."""
MOST_WRONG, SPAN_S = 5, 60.0
"""Number of wrong tokens within a span of time [s], from all visitors together, after which none is compared."""


class TokenError(CtrlRlError):
    """The chosen token is too short."""


class Access:
    """Compares tokens.

    Wrong tokens of all visitors count together, because a visitor can connect anew for each guess. Who has unlocked
    the page before stays unlocked meanwhile.

    Args:
        token: Token; a random one if empty.

    Attributes:
        token: The token.

    Raises:
        TokenError: The token is too short.
    """

    def __init__(self, token: str = "") -> None:
        if token and len(token) < FEWEST_LETTERS:
            raise TokenError(f"a token of {len(token)} letters: must have {FEWEST_LETTERS} or more")
        self.token = token or secrets.token_urlsafe(16)
        self._wrong: deque[float] = deque(maxlen=MOST_WRONG)
        self._lock = Lock()

    def check(self, given: str, now: float | None = None) -> str:
        """Compare a token and return the reason of a refusal, or an empty text.

        Args:
            given: Token that a visitor gave.
            now: Steady time [s]; the present by default.
        """
        now = time.monotonic() if now is None else now
        with self._lock:  # visitors guess side by side
            left = self._wrong[0] + SPAN_S - now if len(self._wrong) == MOST_WRONG else 0.0
            if left > 0.0:
                return f"too many wrong tokens: wait {left:.0f} s"
            if hmac.compare_digest(given.strip().encode("utf-8", "replace"), self.token.encode()):
                return ""
            self._wrong.append(now)
            return "this is not the token"
