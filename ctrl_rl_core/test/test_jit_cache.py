"""Compiled code on disk: damaged files are recompiled; tested in separate processes, as at a node's start."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

PROGRAM = """
import contextlib, io, json, pathlib, sys
sys.path.insert(0, {folder!r})
from twice import twice
from ctrl_rl_core.values.jit_cache import cached_njit

def call():
    quick = cached_njit(twice)
    with contextlib.redirect_stderr(io.StringIO()) as errors:
        value = quick(21.0)
    return value, sum(quick.stats.cache_hits.values()), errors.getvalue()

def emptied(content):
    return content[:0]

def flipped(content):
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 4]) + content[middle + 1 :]

def cut(content):
    return content[:-7]

ends = {{"compiled": call(), "read": call()}}
for suffix in ("nbi", "nbc"):
    for damage in (emptied, flipped, cut):
        (file,) = pathlib.Path({folder!r}).rglob("*." + suffix)
        file.write_bytes(damage(file.read_bytes()))
        ends[suffix + " " + damage.__name__] = call()
        ends[suffix + " " + damage.__name__ + ", then"] = call()
        ends[suffix] = file.name + " in " + str(file.parent)
print(json.dumps(ends))
"""
HITS = """
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
from ctrl_rl_core.values.cells import axis_table
from ctrl_rl_core.values.interpolation import value_at
axes = axis_table([Axis("x", "m", 0.0, 1.0, 2, False)])
print(value_at(np.array([1.0, 3.0], np.float32), axes, np.array([0.5])))
"""


def python(folder: Path, program: str) -> tuple[str, str]:
    """Return standard output and error of a Python process with its compiled code in the folder."""
    answer = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")},
    )
    return answer.stdout.strip(), answer.stderr


@pytest.fixture(scope="module")
def ends(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Output of a process that calls a cached function before and after each kind of damage."""
    folder = tmp_path_factory.mktemp("code")
    (folder / "twice.py").write_text("def twice(x):\n    return 2.0 * x\n")
    os.utime(folder / "twice.py", (1e9, 1e9))
    said, errors = python(folder, PROGRAM.format(folder=str(folder)))
    assert errors == ""
    out: dict[str, Any] = json.loads(said)
    return out


def test_code_is_compiled_once(ends: dict[str, Any]) -> None:
    assert ends["compiled"] == [42.0, 0, ""]
    assert ends["read"] == [42.0, 1, ""]


def test_of_processes_that_start_together_one_compiles(tmp_path: Path) -> None:
    (tmp_path / "twice.py").write_text("def twice(x):\n    return 2.0 * x\n")
    with ThreadPoolExecutor() as pool:
        said = list(pool.map(lambda _: python(tmp_path, HITS.format(folder=str(tmp_path))), range(2)))
    assert sorted(said) == [("42.0 0", ""), ("42.0 1", "")]


@pytest.mark.fault
@pytest.mark.parametrize("damage", ["emptied", "flipped", "cut"])
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_a_damaged_file_is_said_and_compiled_again(ends: dict[str, Any], suffix: str, damage: str) -> None:
    value, hits, errors = ends[f"{suffix} {damage}"]
    assert (value, hits) == (42.0, 0)
    assert f"{ends[suffix]} is damaged or of another version: compiling again" in errors
    assert "Traceback" not in errors
    if suffix == "nbi":
        assert ends[f"{suffix} {damage}, then"] == [42.0, 1, ""]


@pytest.mark.fault
def test_a_value_is_looked_up_in_spite_of_damaged_code(tmp_path: Path) -> None:
    assert python(tmp_path, VALUE_AT) == ("2.0", "")
    for file in tmp_path.rglob("*.nb?"):
        file.write_bytes(b"")
    said, errors = python(tmp_path, VALUE_AT)
    assert said == "2.0"
    assert "is damaged or of another version: compiling again" in errors
    assert python(tmp_path, VALUE_AT) == ("2.0", "")
