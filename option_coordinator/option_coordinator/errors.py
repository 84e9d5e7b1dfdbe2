"""The errors of this package."""

from ctrl_rl_core import CtrlRlError


class OptionError(CtrlRlError):
    """A request about options, a policy or a file is invalid; the message gives the reason and the remedy."""
