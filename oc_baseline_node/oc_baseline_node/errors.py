"""Error class of the package."""

from ctrl_rl_core import CtrlRlError


class OcError(CtrlRlError):
    """Task, data, fit or file do not allow what was asked for; the message says why and what to do."""
