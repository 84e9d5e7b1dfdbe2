"""Cached `--help` pages: importing a command's options takes a second, printing its page a tenth.

A page is the output of the executable itself and stays valid until a file of the workspace's packages or an installed
package changes. `compile`, which the build calls, prints each page once. The width is fixed, so one page serves every
terminal.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout, suppress
from importlib.util import find_spec
from pathlib import Path

from ctrl_rl_core.io.atomic_write import atomic_write

WORDS = frozenset(("-h", "--help"))
_COLUMNS = "100"
_ROOTS = ("ctrl_rl", "sim_bridge", "ttr_", "oc_", "koopman_", "option_")
"""Name prefixes of this workspace's packages."""


def keep_page(executable: Path, door: Callable[[], int]) -> None:
    """Run an executable's help with the output discarded, so that the page is cached.

    Args:
        executable: Its file, as started by `ros2 run`.
        door: Its entry point, see `ctrl_rl_core.entry`.
    """
    words, sys.argv = sys.argv, [str(executable), "--help"]
    try:
        with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere), suppress(SystemExit):
            door()
    finally:
        sys.argv = words


def help_page(work: Callable[[], int]) -> int:
    """Run an executable and return its exit code; if only help is requested, print the cached page instead.

    Args:
        work: Runs the executable with the process's arguments.
    """
    if not WORDS.intersection(sys.argv[1:]):
        return work()
    place = _place()
    text = _kept(place)
    if text is None:
        return _render(work, place)
    sys.stdout.write(text)
    return 0


def _kept(place: Path) -> str | None:
    """Return the cached page from a file, or None if it is missing or outdated."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        page = json.loads(place.read_text(encoding="utf-8"))
        if page["stamp"] == _stamp(page["packages"]):
            return str(page["text"])
    return None


def _render(work: Callable[[], int], place: Path) -> int:
    os.environ["COLUMNS"] = _COLUMNS
    text, code = io.StringIO(), 1
    try:
        with redirect_stdout(text):
            code = work()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1 if end.code else 0
        if code:
            raise
    finally:
        sys.stdout.write(text.getvalue())
    if code == 0:
        packages = sorted({name.partition(".")[0] for name in sys.modules if name.startswith(_ROOTS)})
        page = {"packages": packages, "stamp": _stamp(packages), "text": text.getvalue()}
        with suppress(OSError):  # no place for a cache
            place.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(place, json.dumps(page))
    return code


def _place() -> Path:
    """Return the cache file for this process's arguments."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    words = "\0".join((os.path.abspath(sys.argv[0]), *sys.argv[1:]))
    return Path(base) / "ctrl_rl" / "help" / f"{hashlib.sha256(words.encode()).hexdigest()[:24]}.json"


def _stamp(packages: list[str]) -> str:
    """Return a digest of the names and times of package files and of the folders of installed packages."""
    digest = hashlib.sha256(sys.version.encode())
    for folder in filter(os.path.isdir, sys.path[1:]):  # the first entry is the executable's folder
        digest.update(f"{folder} {os.stat(folder).st_mtime_ns}\n".encode())
    for package in packages:
        spec = find_spec(package)
        for root in (spec.submodule_search_locations or ()) if spec else ():
            for line in _lines(root):
                digest.update(line.encode(errors="replace"))
    return digest.hexdigest()


def _lines(folder: str) -> Iterator[str]:
    with os.scandir(folder) as entries:
        for entry in sorted(entries, key=lambda each: each.name):
            if entry.is_dir():
                if entry.name != "__pycache__":
                    yield from _lines(entry.path)
            else:
                yield f"{entry.path} {entry.stat().st_mtime_ns}\n"
