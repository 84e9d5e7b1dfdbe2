"""Exceptions and warnings of the package."""

from ctrl_rl_core import CtrlRlError


class TimeToReachError(CtrlRlError):
    """A problem, decomposition or file does not allow the request; the message states the cause and the remedy."""


class DoubtfulValueWarning(UserWarning):
    """A solution contradicts a check on it; the message states where, and what to change."""
