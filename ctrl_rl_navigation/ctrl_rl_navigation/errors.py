"""Errors of this package that a user can fix."""

from ctrl_rl_core import CtrlRlError


class NavigationError(CtrlRlError):
    """A goal cannot be reached; the message gives the reason."""
