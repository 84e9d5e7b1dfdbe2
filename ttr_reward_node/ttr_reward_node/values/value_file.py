"""Reader for the files of time-to-reach functions: one grid, or the maximum of several."""

from __future__ import annotations

from os import PathLike

from ctrl_rl_core.io import kind_of, raise_as

from ctrl_rl_core import GridError, ValueGrid
from ttr_reward_node.values.decomposed_value import HEADER_KEY, DecomposedValue


def load_value(path: str | PathLike[str]) -> ValueGrid | DecomposedValue:
    """Read and check a file written by `ValueGrid.save` or `DecomposedValue.save`.

    Raises:
        GridError: The file is missing or damaged, or has other contents.
    """
    with raise_as(GridError, path):
        return DecomposedValue.load(path) if HEADER_KEY in kind_of(path) else ValueGrid.load(path)
