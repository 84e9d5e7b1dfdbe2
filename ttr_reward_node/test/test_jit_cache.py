"""Compiled code on disk: damaged files are compiled again, in a process of its own as a node's start is."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import sys
sys.path.insert(0, {folder!r})
from twice import twice
from ttr_reward_node.jit_cache import cached_njit
quick = cached_njit(twice)
print(quick(21.0), sum(quick.stats.cache_hits.values()))
"""


def run(folder: Path) -> tuple[str, str]:
    """Return what a process that calls the cached function says on standard output and error."""
    (folder / "twice.py").write_text("def twice(x):\n    return 2.0 * x\n")
    os.utime(folder / "twice.py", (1e9, 1e9))
    answer = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(folder=str(folder))],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")},
    )
    return answer.stdout.strip(), answer.stderr


def emptied(content: bytes) -> bytes:
    return content[:0]


def flipped(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 4]) + content[middle + 1 :]


def cut(content: bytes) -> bytes:
    return content[:-7]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder whose function has been compiled once and read once."""
    folder = tmp_path_factory.mktemp("code")
    assert run(folder) == ("42.0 0", "")
    assert run(folder) == ("42.0 1", "")
    return folder


@pytest.mark.fault
@pytest.mark.parametrize("damage", [emptied, flipped, cut])
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_a_damaged_file_is_said_and_compiled_again(folder: Path, suffix: str, damage) -> None:
    (file,) = (folder / "cache").rglob(f"*.{suffix}")
    file.write_bytes(damage(file.read_bytes()))
    said, errors = run(folder)
    assert said == "42.0 0"
    assert f"{file.name} in {file.parent} is damaged or of another version: compiling again" in errors
    assert "Traceback" not in errors
    if suffix == "nbi":
        assert run(folder) == ("42.0 1", "")
