"""Errors of offline learning."""

from ctrl_rl_core import CtrlRlError


class OfflineError(CtrlRlError):
    """Bags do not suffice for what is asked of them; the message says what is missing."""
