"""Errors of policies."""

from ctrl_rl_core.errors import CtrlRlError


class PolicyError(CtrlRlError):
    """A policy cannot be read, or returns no command; the message gives the reason."""
