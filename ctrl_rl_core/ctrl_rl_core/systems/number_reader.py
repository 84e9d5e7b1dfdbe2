"""Reads named numbers, such as a model's state, from an environment's observation or `info`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.io.file_checks import one_line

Source = str | Callable[[Any], ArrayLike] | Callable[[Any, Mapping[str, Any]], ArrayLike]
"""Key of `info`; a function of the observation; or a function of the observation and `info`."""


class NumberReader:
    """Reads vectors of named, finite numbers from an environment's observation and `info`.

    Args:
        source: Key of `info`, function of the observation, or function of the observation and `info`.
        names: Names of the numbers, in order, with units if messages should show them.
        what: Noun for the vector in messages, such as "state".
        error: Error class to raise.
        rows: Number of environments if vectorised; None for a single environment.
    """

    def __init__(
        self, source: Source, names: Sequence[str], what: str, error: type[CtrlRlError], rows: int | None = None
    ) -> None:
        self._read, self._names, self._what, self._error = reader_of(source), tuple(names), what, error
        self._shape = (len(self._names),) if rows is None else (rows, len(self._names))
        self._where = f"info['{source}']" if isinstance(source, str) else f"the function for the {what}"

    def __call__(self, observation: Any, info: Mapping[str, Any]) -> NDArray[np.float64]:
        """Return the numbers (n,), or (rows, n).

        Raises:
            CtrlRlError: The numbers are missing, too few, too many, or not finite; raised as `error`.
        """
        try:
            found = np.asarray(self._read(observation, info), dtype=np.float64)
        except KeyError as missing:
            there = ", ".join(map(str, info)) or "nothing"
            raise self._error(f"{self._where}: no {missing}; info has {there}: name another key, or give a function "
                              f"that returns the {self._what} ({', '.join(self._names)})") from None  # fmt: skip
        if found.shape != self._shape:
            raise self._error(f"{self._where} has the shape {found.shape}: must be {self._shape}, "
                              f"{', '.join(self._names)}")  # fmt: skip
        if not np.isfinite(found).all():
            raise self._error(f"{self._where} is {one_line(found.tolist(), 100)}: every number must be finite")
        return found


def reader_of(source: Source) -> Callable[[Any, Mapping[str, Any]], ArrayLike]:
    """Return a reader function of observation and info for a source."""
    if isinstance(source, str):
        key = source
        return lambda _, info: info[key]
    function: Any = source
    if _takes_two(function):
        return function
    return lambda observation, _: function(observation)


def _takes_two(function: Callable[..., Any]) -> bool:
    """Return whether a function requires two positional arguments."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):  # a built-in function without a signature
        return False
    needed = [each for each in parameters if each.kind <= each.POSITIONAL_OR_KEYWORD and each.default is each.empty]
    return len(needed) > 1
