"""Error class of the package."""

from ctrl_rl_core import CtrlRlError


class TimeToReachError(CtrlRlError):
    """A problem, decomposition or file does not allow what was asked; the message says why and what to do."""


class DoubtfulValueWarning(UserWarning):
    """A solution contradicts what was tried on it; the message says where, and what to change."""
