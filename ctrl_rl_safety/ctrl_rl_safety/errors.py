"""Errors of this package that a user can fix."""

from ctrl_rl_core import CtrlRlError


class SafetyError(CtrlRlError):
    """A robot model, a bag or an option is unusable; the message gives the reason."""
