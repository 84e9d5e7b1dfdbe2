"""Error class of the package."""

from ctrl_rl_core import CtrlRlError


class OcError(CtrlRlError):
    """Task, data, fit or file do not allow the request; the message gives the reason and the remedy."""
