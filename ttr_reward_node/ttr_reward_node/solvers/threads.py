"""Work shared out between threads, in parts that are fixed: results do not depend on the number of cores."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Result = TypeVar("Result")


def share(work: Callable[[int, int], Result], parts: int) -> list[Result]:
    """Return the results of `work(part, parts)` for each part, done at the same time where there is more than one.

    Compiled work, which lets go of the interpreter's lock, takes as many cores as it has parts.
    """
    if parts == 1:
        return [work(0, 1)]
    with ThreadPoolExecutor(parts) as pool:
        return list(pool.map(lambda part: work(part, parts), range(parts)))
