"""Errors of datasets."""

from ctrl_rl_bags.format.checks import BagError

LARGEST_INFO = 16_000_000
"""Bytes of a dataset's description in JSON."""


class DatasetError(BagError):
    """A dataset cannot be written or read; the message is the reason."""


MEMORY = 1 << 30
"""Bytes that reading a dataset may take, beside a multiple of its size."""
