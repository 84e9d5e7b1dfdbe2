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
from ctrl_rl_core.values.jit_cache import cached_njit
quick = cached_njit(twice)
print(quick(21.0), sum(quick.stats.cache_hits.values()))
"""


VALUE_AT = """
import numpy as np
from ctrl_rl_core.values.grid_axis import Axis
from ctrl_rl_core.values.interpolation import axis_table, value_at
axes = axis_table([Axis("x", "m", 0.0, 1.0, 2, False)])
print(value_at(np.array([1.0, 3.0], np.float32), axes, np.array([0.5])))
"""


def run(folder: Path) -> tuple[str, str]:
    """Return what a process that calls the cached function says on standard output and error."""
    (folder / "twice.py").write_text("def twice(x):\n    return 2.0 * x\n")
    os.utime(folder / "twice.py", (1e9, 1e9))
    return python(folder, PROGRAM.format(folder=str(folder)))


def python(folder: Path, program: str) -> tuple[str, str]:
    """Return what a Python process with its compiled code in the folder says on standard output and error."""
    answer = subprocess.run(
        [sys.executable, "-c", program],
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


@pytest.mark.fault
def test_a_value_is_looked_up_in_spite_of_damaged_code(tmp_path: Path) -> None:
    assert python(tmp_path, VALUE_AT) == ("2.0", "")
    for file in tmp_path.rglob("*.nb?"):
        file.write_bytes(b"")
    said, errors = python(tmp_path, VALUE_AT)
    assert said == "2.0"
    assert "is damaged or of another version: compiling again" in errors
    assert python(tmp_path, VALUE_AT) == ("2.0", "")
