"""Work distributed to threads in fixed parts, so that results do not depend on the number of cores."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

_MOST_THREADS = 8  # more threads only wait for the GIL between NumPy calls
Item = TypeVar("Item")
Result = TypeVar("Result")


def share(work: Callable[[int, int], Result], parts: int) -> list[Result]:
    """Return the results of `work(part, parts)` for each part, computed in parallel if there are several.

    Compiled work, which releases the GIL, uses as many cores as it has parts.
    """
    if parts == 1:
        return [work(0, 1)]
    with ThreadPoolExecutor(parts) as pool:
        return list(pool.map(lambda part: work(part, parts), range(parts)))


def for_each(work: Callable[[Item], Result], items: Iterable[Item], alone: bool = False) -> list[Result]:
    """Return the results of `work(item)` for each item, in order, computed on the available cores.

    Args:
        work: Function to call.
        items: What it is called with.
        alone: Whether to use this thread alone, which saves the memory that each thread works in.
    """
    items = list(items)
    threads = min(len(os.sched_getaffinity(0)), _MOST_THREADS, len(items))
    if alone or threads <= 1:  # a thread has memory of its own, which stays with the process
        return [work(item) for item in items]
    found: list[Any] = [None] * len(items)
    waiting = deque(enumerate(items))

    def take(_part: int, _parts: int) -> None:
        while True:
            try:
                number, item = waiting.popleft()  # atomic, unlike `next` of an iterator of our own
            except IndexError:
                return
            try:
                found[number] = work(item)
            except BaseException:
                waiting.clear()
                raise

    share(take, threads)  # rather than a future for each item, which would take more memory than small tables
    return found
