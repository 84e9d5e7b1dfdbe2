"""The errors of this package."""

from ctrl_rl_core import CtrlRlError


class KoopmanError(CtrlRlError):
    """Data, model or policy file do not allow a controller; the message says why and what to do."""
