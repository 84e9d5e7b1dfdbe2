"""The errors of this package."""

from ctrl_rl_core.errors import CtrlRlError


class OptionError(CtrlRlError):
    """Options, a policy or a file do not allow what was asked; the message says why and what to do."""
