"""The error of this package."""

from ctrl_rl_core import CtrlRlError


class SimulationError(CtrlRlError):
    """A world cannot be built or run as requested."""
