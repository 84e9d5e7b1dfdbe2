"""The errors of this package."""

from ctrl_rl_core import CtrlRlError


class TrainingError(CtrlRlError):
    """A run cannot begin or go on, or a policy cannot be read; the message says why and what to do."""
