"""Durations of the steps as codes of 16 bits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

_EXACT = 1 << 18  # number of durations up to which they are kept until all are known, and distinct ones numbered
_PART = 1 << 16  # number of codes renumbered at once
_MOST_CODES = 1 << 16  # number of durations representable by 16 bits
_DROPPED = 12  # bits of a single-precision number's mantissa that a code lacks: 11 are left, 1 part in 4,096
_LEAST = -12  # exponent of the shortest duration, in powers of two of the unit; the longest has 32 more
_FIRST = (127 + _LEAST) << (23 - _DROPPED)  # bits of the shortest duration


class DurationTable:
    """Durations of the steps by slab and pair; 0 where there is no step.

    A small table is exact if it has few distinct durations, as for a robot that moves the same way everywhere. In a
    large one, where each node has its own steps, each duration is rounded to 11 binary digits as it is entered: the
    errors mostly average out over successive steps. Durations below 2^-12 units count as that, durations above 2^20
    units as no step.
    """

    def __init__(self, shape: tuple[int, int, int, int], unit: float) -> None:
        """Initialise.

        Args:
            shape: Number of slabs, disturbances, lengths and controls.
            unit: Time scale of the problem [s].
        """
        self._unit = unit if unit > 0.0 else 1.0
        self._rounded = math.prod(shape) > _EXACT
        self._table: NDArray[Any] = np.empty(shape, np.uint16 if self._rounded else np.float32)

    def enter(self, slabs: slice, length: int, durations: NDArray[np.float64]) -> None:
        """Enter the durations (k disturbances controls,) [s] of the steps of one length from k slabs."""
        entries = self._table[slabs, :, length]
        with np.errstate(over="ignore"):  # a state that hardly moves needs for ever
            entries[...] = (self._round(durations) if self._rounded else durations).reshape(entries.shape)

    def codes(self) -> tuple[NDArray[np.uint16], NDArray[np.float64]]:
        """Return the code of each duration (slabs, pairs), and the durations by code [s]; code 0 is no step."""
        table = self._table.reshape(len(self._table), -1)
        if self._rounded:
            return table, self._shorten(table)
        book, found = np.unique(table, return_inverse=True)
        if len(book) < _MOST_CODES:
            zero = int(len(book) == 0 or book[0] > 0.0)  # code 0 means no step, even if every pair has one
            numbers = found.reshape(table.shape).astype(np.uint16) + np.uint16(zero)
            return numbers, np.concatenate((np.zeros(zero), book.astype(np.float64)))
        codes = self._round(table)
        return codes, self._shorten(codes)

    def _shorten(self, codes: NDArray[np.uint16]) -> NDArray[np.float64]:
        """Renumber codes in place so that the shortest duration in use has code 1; return the durations by code [s]."""
        most = int(codes.max(initial=0))
        if most == 0:
            return np.zeros(1)
        parts = np.array_split(codes, math.ceil(codes.size / _PART))
        least = min(int(part.min(initial=most, where=part > 0)) for part in parts)
        for part in parts:
            np.subtract(part, least - 1, out=part, where=part > 0)
        bits = (np.arange(least - 1, most, dtype=np.uint32) + np.uint32(_FIRST)) << np.uint32(_DROPPED)
        return np.concatenate(([0.0], bits.view(np.float32) * self._unit))

    def _round(self, durations: NDArray[Any]) -> NDArray[np.uint16]:
        """Return codes of durations: the exponent and the upper digits of the mantissa, as one number."""
        with np.errstate(over="ignore"):
            bits = (durations * (1.0 / self._unit)).astype(np.float32).view(np.int32)
        codes = ((bits + (1 << (_DROPPED - 1))) >> _DROPPED) - (_FIRST - 1)
        there = (durations > 0.0) & (codes < _MOST_CODES)
        return np.where(there, np.maximum(codes, 1), 0).astype(np.uint16)
