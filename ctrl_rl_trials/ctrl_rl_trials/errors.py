"""The error of this package."""

from ctrl_rl_core import CtrlRlError


class TrialError(CtrlRlError):
    """A benchmark cannot run as requested."""
