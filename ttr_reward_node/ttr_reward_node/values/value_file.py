"""Reading of a time-to-reach function from its file: one grid, or the maximum of several."""

from __future__ import annotations

from os import PathLike

from ctrl_rl_core.io import kind_of, raise_as

from ctrl_rl_core import GridError, ValueGrid
from ttr_reward_node.values.decomposed_value import HEADER_KEY, DecomposedValue


def load_value(path: str | PathLike[str]) -> ValueGrid | DecomposedValue:
    """Read and check a file that `ValueGrid.save` or `DecomposedValue.save` wrote.

    Raises:
        GridError: The file is missing or damaged, or holds something else.
    """
    with raise_as(GridError, path):
        return DecomposedValue.load(path) if HEADER_KEY in kind_of(path) else ValueGrid.load(path)
