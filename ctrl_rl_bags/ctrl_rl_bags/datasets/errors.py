"""Errors of datasets."""

from ctrl_rl_bags.format.checks import BagError

LARGEST_INFO = 16_000_000
"""Bytes of a dataset's description in JSON."""


class DatasetError(BagError):
    """A dataset cannot be written or read; the message is the reason."""
