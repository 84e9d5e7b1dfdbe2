"""Machine code that is kept on disk between processes, where there is a place for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def cached(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    """Compile a function at its first call, or read its code from disk; options as for `numba.njit`."""
    try:
        return _njit(function, cache=True, **options)
    except RuntimeError:  # no writable cache folder: a read-only installation without a home
        return _njit(function, **options)


def _njit(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    compiled: Callable[..., Any] = njit(**options)(function)
    return compiled
