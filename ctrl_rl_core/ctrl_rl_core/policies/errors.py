"""Errors of policies."""

from ctrl_rl_core.errors import CtrlRlError


class PolicyError(CtrlRlError):
    """A policy cannot be read, or gives no command; the message is the reason."""
