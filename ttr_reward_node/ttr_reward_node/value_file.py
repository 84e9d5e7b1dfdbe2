"""Read a time-to-reach function from its file: one grid, or several joined."""

from __future__ import annotations

from os import PathLike

from ctrl_rl_core.value_grid import ValueGrid
from safetensors import SafetensorError, safe_open

from ttr_reward_node import decomposed_value
from ttr_reward_node.decomposed_value import DecomposedValue


def load_value(path: str | PathLike[str]) -> ValueGrid | DecomposedValue:
    """Read and check a file that `ValueGrid.save` or `DecomposedValue.save` wrote.

    Raises:
        GridError: names the file and what is wrong with it.
    """
    try:
        with safe_open(path, framework="numpy") as file:
            decomposed = decomposed_value.HEADER_KEY in (file.metadata() or {})
    except (OSError, SafetensorError):
        decomposed = False  # the reader of grids says what is wrong
    return DecomposedValue.load(path) if decomposed else ValueGrid.load(path)
