"""Broken files of every kind that the suite reads: each is loaded as what it is, or refused in one line."""

from __future__ import annotations

import json
import logging
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import _mutations
import numpy as np
from _attack import Attack
from _mutations import Mutate, broken
from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.results import Result, as_markdown, read_benchmarks, read_results, write_results
from ctrl_rl_core.tasks import FOLDER, load_navigation_task, load_task, task_names
from ctrl_rl_core.value_grid import Axis, ValueGrid

ROOT = Path(__file__).resolve().parents[2]
LONGEST = 1000
"""Characters of an error."""
DIGEST = "a" * 64
Load = Callable[[Path], Any]


@dataclass(frozen=True)
class Kind:
    """A kind of file: how whole ones come about in an empty folder, what breaks one, and who reads it."""

    name: str
    make: Callable[[Path], list[Path]]
    how: Mutate
    load: Load


def check(kind: Kind, path: Path, content: bytes) -> str:
    """Load a broken file; return what was said of it, empty where it was taken.

    Raises:
        AssertionError: the error is none of the suite's, or not one line.
    """
    path.write_bytes(content)
    try:
        kind.load(path)
    except CtrlRlError as error:
        said = str(error)
        assert said.isprintable(), f"{kind.name}: not one line: {said[:500]!r}"
        assert len(said) <= LONGEST, f"{kind.name}: {len(said)} characters: {said[:500]}"
        return said
    except Exception as error:
        raise AssertionError(
            f"{kind.name}: {type(error).__name__} escaped:\n{traceback.format_exc()[-2500:]}"
        ) from None
    return ""


def attack(kind: Kind, count: int) -> Callable[[np.random.Generator, Path], None]:
    """Return a round that breaks a kind of file so many times."""

    def run(random: np.random.Generator, folder: Path) -> None:
        logging.disable(logging.WARNING)  # files without digests are told once each
        files = kind.make(folder)
        for _ in range(count):
            path = files[int(random.integers(len(files)))]
            whole = path.read_bytes()
            try:
                check(kind, path, broken(whole, kind.how, random))
            finally:
                path.write_bytes(whole)

    return run


def _tasks(folder: Path) -> list[Path]:
    files = [FOLDER / f"{name}.yaml" for name in task_names()]
    return [_copy(file, folder) for file in files]


def _load_task(path: Path) -> None:
    task = load_task(path)
    if task.kind == "navigation":
        load_navigation_task(path).build_world()


def _grids(folder: Path) -> list[Path]:
    axes = (Axis("x", "m", -1.0, 1.0, 5), Axis("theta", "rad", -np.pi, np.pi, 4, periodic=True))
    values = np.arange(20, dtype=np.float32).reshape(5, 4)
    values[1, 2] = np.inf
    ValueGrid(values, axes, "time_to_reach", "mine", DIGEST, "a solver", 1e-3, {"note": "x"}).save(
        folder / "grid.safetensors"
    )
    return [folder / "grid.safetensors"]


def _load_grid(path: Path) -> None:
    assert ValueGrid.load(path).digest


def _results(folder: Path) -> list[Path]:
    rows = [Result("mine", "return", "1", [1.0, 2.0], 3.0), Result("mine", "time", "s", [float("nan")])]
    write_results(folder / "mine.json", "mine", [0, 1], rows, {"task": "mine", "curves": {}})
    return [folder / "mine.json"]


def _benchmarks(folder: Path) -> list[Path]:
    row = {"benchmark": "b", "name": "look-up", "value": 0.286, "unit": "us", "against": "scipy", "ratio": None}
    (folder / "bench.json").write_text(json.dumps([row, {**row, "ratio": 2.0}]))
    return [folder / "bench.json"]


def _copy(file: Path, folder: Path) -> Path:
    (folder / file.name).write_bytes(file.read_bytes())
    return folder / file.name


KINDS = (
    Kind("task", _tasks, _mutations.change_yaml, _load_task),
    Kind("grid", _grids, _mutations.change_tensors, _load_grid),
    Kind("results", _results, _mutations.change_json, lambda path: as_markdown(read_results(path.parent))),
    Kind("benchmarks", _benchmarks, _mutations.change_json, lambda path: as_markdown([], read_benchmarks(path))),
)

ATTACKS = tuple(
    Attack(
        f"files-{kind.name}",
        f"A broken file ({kind.name}) is loaded as what it is or refused in one line, quickly and in bounded memory.",
        attack(kind, 300),
        memory=6 * 1024**3,
    )
    for kind in KINDS
)
