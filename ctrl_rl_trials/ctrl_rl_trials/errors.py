"""The error of this package."""

from ctrl_rl_core import CtrlRlError


class TrialError(CtrlRlError):
    """A benchmark cannot be run as it was asked for."""
