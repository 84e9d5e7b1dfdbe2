"""The error of this package."""

from ctrl_rl_core import CtrlRlError


class LearningError(CtrlRlError):
    """A run, a policy, bags or the robot do not serve what is asked; the message says why and what to do."""
