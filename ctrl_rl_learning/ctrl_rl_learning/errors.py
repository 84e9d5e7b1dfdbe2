"""The error of this package."""

from ctrl_rl_core import CtrlRlError


class LearningError(CtrlRlError):
    """A run, policy, bag or robot is unsuitable for the request; the message says why and what to do."""
