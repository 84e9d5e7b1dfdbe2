"""Pages of `--help`, kept between calls: a command's options take a second of imports, its page a tenth.

A page is what the executable itself has printed, for as long as no file of the workspace's packages and no installed
package has changed. `compile`, which the build calls, prints each once. The width is the same everywhere, so that one
page serves each terminal.
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
"""Beginnings of the names of this workspace's packages."""


def keep_page(executable: Path, door: Callable[[], int]) -> None:
    """Print the help of an executable to nowhere, so that its page is kept.

    Args:
        executable: Its file, as `ros2 run` starts it.
        door: Its door, see `ctrl_rl_core.entry`.
    """
    words, sys.argv = sys.argv, [str(executable), "--help"]
    try:
        with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere), suppress(SystemExit):
            door()
    finally:
        sys.argv = words


def help_page(work: Callable[[], int]) -> int:
    """Return the exit code of an executable; if it is only asked for its help, print the page that was kept.

    Args:
        work: Runs the executable with the process's words.
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
    """Return the page in a file, if it is there and still holds."""
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
        with suppress(OSError):  # nowhere to keep it
            place.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(place, json.dumps(page))
    return code


def _place() -> Path:
    """Return the file of the page of this process's words."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    words = "\0".join((os.path.abspath(sys.argv[0]), *sys.argv[1:]))
    return Path(base) / "ctrl_rl" / "help" / f"{hashlib.sha256(words.encode()).hexdigest()[:24]}.json"


def _stamp(packages: list[str]) -> str:
    """Return the digest of names and times of the files of packages, and of the folders where others are installed."""
    digest = hashlib.sha256(sys.version.encode())
    for folder in filter(os.path.isdir, sys.path[1:]):  # the first is that of the executable
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
