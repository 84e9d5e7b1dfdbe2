"""On-disk cache of machine code between processes, recompiled if damaged.

Processes that start simultaneously compile each function once: the others wait and load the first one's result.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from numba import njit
from numba.core.caching import IndexDataCacheFile
from numba.core.compiler_lock import global_compiler_lock

from ctrl_rl_core.processes.exclusive_lock import LockError, exclusive_lock

_PATIENCE_S = 60.0
"""Time for which a process waits for another one's code before compiling its own [s]: the other may be frozen."""
_PAUSE_S = 0.02
_compiling: set[Path] = set()


def cached_njit(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    """Compile a function at its first call, or load its code from disk; options as for `numba.njit`."""
    try:
        compiled: Any = njit(cache=True, **options)(function)
    except RuntimeError:  # no writable cache folder: a read-only installation without a home folder
        compiled = njit(**options)(function)
    cache: Any = getattr(compiled, "_cache", None)
    if hasattr(cache, "_cache_file"):
        stamps = tuple(sorted((file, *_stamp(file)) for file in _sources(function)))
        cache._cache_file = _CheckedFile(cache._cache_path, cache._impl.filename_base, stamps)
        compiled.compile = _in_turn(compiled.compile, cache._cache_file.lock)
    out: Callable[..., Any] = compiled
    return out


def _sources(function: Any, found: set[Any] | None = None) -> set[str]:
    """Return the source files of a function and of all compiled functions that it calls and thus contains."""
    seen = set() if found is None else found
    seen.add(function)
    for name in function.__code__.co_names:
        called = getattr(function.__globals__.get(name), "py_func", None)
        if called is not None and called not in seen:
            _sources(called, seen)
    return {each.__code__.co_filename for each in seen}


def _stamp(file: str) -> tuple[float, int]:
    """Return the modification time and size of a file; zeros if it does not exist."""
    with suppress(OSError):
        state = os.stat(file)
        return state.st_mtime, state.st_size
    return 0.0, 0


def _in_turn(compile_: Callable[..., Any], lock: Path) -> Callable[..., Any]:
    """Serialise a function's `compile` across processes; Numba's own lock covers threads of one process."""

    def compile_in_turn(signature: Any) -> Any:
        with global_compiler_lock, _turn(lock):
            return compile_(signature)

    return compile_in_turn


@contextmanager
def _turn(lock: Path) -> Iterator[None]:
    """Hold a lock file, if a cache folder exists and no other process holds the lock forever."""
    with ExitStack() as turn:
        deadline = time.monotonic() + _PATIENCE_S
        while lock not in _compiling and time.monotonic() < deadline:  # already locked if the function calls itself
            try:
                turn.enter_context(exclusive_lock(lock))
            except LockError:
                time.sleep(_PAUSE_S)
                continue
            except OSError:
                break
            _compiling.add(lock)
            turn.callback(_compiling.remove, lock)
        yield


class _CheckedFile(IndexDataCacheFile):
    """Numba cache files with a leading digest: Numba runs any bytes it finds, and crashes on an empty file."""

    @property
    def lock(self) -> Path:
        """Lock file used while this function is compiled."""
        return Path(f"{self._index_path}.lock")

    def save(self, key: Any, data: Any) -> None:
        """Cache the code, or log why it cannot be cached; the function works either way."""
        try:
            super().save(key, data)
        except OSError as error:
            _say(f"compiled code cannot be kept in {self._cache_path} ({error.strerror}); it is compiled at each start")

    def _load_index(self) -> dict[Any, str]:
        with suppress(OSError):
            version, stamp, overloads = pickle.loads(_read(self._index_path))  # noqa: S301 Numba's own format
            if (version, stamp) == (self._version, self._source_stamp):
                return dict(overloads)
        return {}

    def _save_index(self, overloads: dict[Any, str]) -> None:
        self._write(self._index_path, (self._version, self._source_stamp, overloads))

    def _load_data(self, name: str) -> Any:
        return pickle.loads(_read(self._data_path(name)))  # noqa: S301

    def _save_data(self, name: str, data: Any) -> None:
        self._write(self._data_path(name), data)

    def _write(self, path: str, data: Any) -> None:
        body = self._dump(data)
        with self._open_for_write(path) as file:
            file.write(hashlib.sha256(body).digest() + body)


def _read(path: str) -> bytes:
    """Return the content of a file that follows its digest.

    Raises:
        OSError: The file is missing or damaged; the code is then recompiled and the file rewritten.
    """
    content = Path(path).read_bytes()
    size = hashlib.sha256().digest_size
    if hashlib.sha256(content[size:]).digest() != content[:size]:
        _say(f"{os.path.basename(path)} in {os.path.dirname(path)} is damaged or of another version: compiling again")
        raise OSError(f"{path} is damaged")
    return content[size:]


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")
