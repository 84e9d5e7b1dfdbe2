"""The errors of this package."""

from ctrl_rl_core import CtrlRlError


class RobotError(CtrlRlError):
    """The robot, the simulator or the safety filter does not answer, or a setting does not serve."""
