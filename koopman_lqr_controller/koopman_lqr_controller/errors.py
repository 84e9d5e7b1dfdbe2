"""The errors of this package."""

from ctrl_rl_core import CtrlRlError


class KoopmanError(CtrlRlError):
    """Data, model or policy file do not permit a controller; the message gives the reason and the remedy."""
