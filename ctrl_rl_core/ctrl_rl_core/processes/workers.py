"""Maps a function over items in several processes, which end with their parent and leave Ctrl-C to it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import wait as wait_for_any
from typing import Any, TypeVar

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.processes.signals import TERMINAL_SIGNALS, handle_signals

Item = TypeVar("Item")
Answer = TypeVar("Answer")
_TICK = 1.0

CONTEXT = multiprocessing.get_context("forkserver")
"""Fork server: single-threaded, and has already imported the modules that the work needs."""


class WorkersError(CtrlRlError):
    """A worker process was killed."""


def map_in_processes(
    work: Callable[[Item], Answer],
    items: Sequence[Item],
    workers: int = 0,
    prepare: Callable[..., None] | None = None,
    terms: tuple[Any, ...] = (),
    tick: Callable[[], None] | None = None,
) -> Iterator[Answer]:
    """Yield the results as they are ready, not in the order of the items.

    Args:
        work: Function of one item, importable by name; called in a worker.
        items: Arguments of `work`, begun in this order.
        workers: Number of processes, at most one per item; 0 for one per core.
        prepare: Function called once in each worker before the first item; importable by name.
        terms: Arguments of `prepare`.
        tick: Called in this process about once a second, e.g. to show progress.

    Raises:
        WorkersError: A worker was killed.
        Exception: Any exception of `work`; items not yet started are dropped.
    """
    _preload(work, *items[:1])
    workers = max(1, min(len(items), workers or os.cpu_count() or 1))
    with ProcessPoolExecutor(workers, CONTEXT, _begin, (prepare, terms)) as pool:
        with _deaf_to_interrupts():
            waiting: set[Future[Answer]] = {pool.submit(work, item) for item in items}
        try:
            while waiting:
                finished, waiting = wait(waiting, None if tick is None else _TICK, FIRST_COMPLETED)
                if tick is not None:
                    tick()
                yield from (future.result() for future in finished)
        except BrokenProcessPool:
            raise WorkersError("a worker process was killed: run the same command again to resume") from None
        except BaseException:
            # Running items are not waited for: they may take minutes, and can be resumed by another run.
            for process in list((pool._processes or {}).values()):
                process.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _preload(work: Callable[..., Any], *items: object) -> None:
    """Preload the modules of a function and its items in the fork server; no effect once the server runs."""
    function = work.func if isinstance(work, partial) else work
    CONTEXT.set_forkserver_preload([function.__module__, *(type(item).__module__ for item in items)])


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Make processes started in the block ignore terminal signals; this process handles them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    with handle_signals(signal.SIG_IGN, TERMINAL_SIGNALS):
        yield


def _begin(prepare: Callable[..., None] | None, terms: tuple[Any, ...]) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare(*terms)


def _end_with_parent() -> None:
    """Exit when the parent dies: an orphan must not keep writing to a folder that the next run resumes."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for_any([parent.sentinel])
        os._exit(1)
