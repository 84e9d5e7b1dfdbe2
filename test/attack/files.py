"""Broken files of every kind that the suite reads: each is loaded as what it is, or refused in one line."""

from __future__ import annotations

import importlib
import json
import logging
import traceback
from argparse import Namespace
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any

import _mutations
import numpy as np
from _attack import Attack
from _mutations import Mutate, broken

from ctrl_rl_core import (
    Axis,
    CtrlRlError,
    Result,
    ValueGrid,
    load_navigation_task,
    load_task,
    results_page,
    task_file,
    task_names,
    write_results,
)

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
        try:
            files = kind.make(folder)
            for _ in range(count):
                path = files[int(random.integers(len(files)))]
                whole = path.read_bytes()
                check(kind, path, broken(whole, kind.how, random))
                path.write_bytes(whole)
        finally:
            logging.disable(logging.NOTSET)

    return run


def _tasks(folder: Path) -> list[Path]:
    return [_copy(task_file(name), folder) for name in task_names()]


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


def _koopman(name: str) -> Callable[[Path], list[Path]]:
    from koopman_lqr_controller import find_policy

    return lambda folder: [_copy(find_policy(name), folder)]


def _load_koopman(path: Path) -> None:
    from ctrl_rl_core import ScanGeometry
    from koopman_lqr_controller import load_policy

    policy = load_policy(path)
    scan = ScanGeometry(360, 0.0, np.pi / 180, 0.12, 3.5)
    command = policy.decide(np.full(360, 1.0, np.float32), scan, 0.1, 0.0).command
    assert np.isfinite(command).all(), "it drives with a command that is none"


def _options(folder: Path) -> list[Path]:
    from option_coordinator import policy_file

    return [_copy(policy_file("delivery_team"), folder)]


def _load_options(path: Path) -> None:
    from option_coordinator import OptionPolicy

    OptionPolicy.load(path)


def _values(folder: Path) -> list[Path]:
    from oc_baseline_node import shipped_values

    return [_copy(file, folder) for file in shipped_values().values()]


def _load_value(path: Path) -> None:
    from oc_baseline_node import load_value

    load_value(path).value(np.zeros(len(load_value(path).state_names)))


def _decomposed(folder: Path) -> list[Path]:
    from ttr_reward_node import DecomposedValue

    axes = (Axis("x", "m", 0.0, 1.0, 3), Axis("y", "m", 0.0, 1.0, 4))
    grids = [
        ValueGrid(np.ones(axis.count, np.float32), (axis,), "time_to_reach", "mine", DIGEST, "s", 0.0) for axis in axes
    ]
    DecomposedValue(tuple(grids), axes, "halves", (("y",), ("x",))).save(folder / "whole.safetensors")
    return [folder / "whole.safetensors"]


def _load_decomposed(path: Path) -> None:
    from ttr_reward_node import load_value

    value = load_value(path)
    value.value(np.zeros(len(value.state_names)))


def _value_data(folder: Path) -> list[Path]:
    from oc_baseline_node.value_data import open_folder, write_chunk

    from oc_baseline_node import DataSettings, ValueData

    random = np.random.default_rng(0)
    open_folder(folder, _problem(), DataSettings(2))
    data = ValueData(
        random.random((2, 5, 3)),
        random.random((2, 4, 2)),
        np.full(2, 0.1),
        np.ones(2),
        random.random((1, 3)),
        ("none",),
        np.array([True]),
        np.ones(1),
    )
    write_chunk(folder, 0, data)
    return list(folder.glob("*.npz"))


def _load_value_data(path: Path) -> None:
    from oc_baseline_node import load_data

    load_data(path.parent, _problem())


def _load_settings(path: Path) -> None:
    _load_value_data(path)


@cache
def _problem() -> Any:
    from oc_baseline_node import formulate

    return formulate(load_navigation_task("car_navigation"))


def _teams(folder: Path) -> list[Path]:
    from option_coordinator import team_file

    return [_copy(team_file("delivery_team"), folder)]


def _load_team(path: Path) -> None:
    from option_coordinator import load_option_task, load_team

    with suppress(CtrlRlError):  # it may be taken for a task of another kind
        load_option_task(str(path))
    load_team(str(path))


def _figures(name: str) -> Callable[[Path], list[Path]]:
    return lambda folder: [_copy(ROOT / "docs/results" / f"{name}.json", folder)]


def _draw(module: str, function: str) -> Load:
    """Return what reads a results file and draws it: the work of a package's command."""

    def load(path: Path) -> None:
        import matplotlib as mpl

        mpl.use("Agg")
        many = [path] if module.endswith(".compare") else path
        options = Namespace(results=many, task=None, output=path.parent / "pictures", algorithm=None)
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            getattr(importlib.import_module(module), function)(options)
        mpl.pyplot.close("all")

    return load


KINDS = (
    Kind("task", _tasks, _mutations.change_yaml, _load_task),
    Kind("grid", _grids, _mutations.change_tensors, _load_grid),
    Kind("results", _results, _mutations.change_json, lambda path: results_page(path.parent)),
    Kind("team", _teams, _mutations.change_yaml, _load_team),
    Kind("decomposed", _decomposed, _mutations.change_tensors, _load_decomposed),
    Kind("koopman", _koopman("curved_corridor"), _mutations.change_tensors, _load_koopman),
    Kind("edmd", _koopman("curved_corridor_edmd"), _mutations.change_tensors, _load_koopman),
    Kind("options", _options, _mutations.change_tensors, _load_options),
    Kind("values", _values, _mutations.change_tensors, _load_value),
    Kind("value-data", _value_data, _mutations.change_arrays, _load_value_data),
    Kind("settings", lambda f: [_value_data(f)[0].with_name("settings.json")], _mutations.change_json, _load_settings),
    Kind(
        "figures-koopman",
        _figures("koopman_figure_4.3_cheetah_run"),
        _mutations.change_json,
        _draw("koopman_lqr_controller.cli.compare", "_draw"),
    ),
    Kind(
        "figures-options",
        _figures("options_delivery_team"),
        _mutations.change_json,
        _draw("option_coordinator.training.cli.learning", "_figures"),
    ),
    Kind(
        "figures-oc",
        _figures("oc_training_quad_trap"),
        _mutations.change_json,
        _draw("oc_baseline_node.training.cli", "_figures"),
    ),
    Kind(
        "figures-ttr",
        _figures("ttr_training_car_ttr"),
        _mutations.change_json,
        _draw("ttr_reward_node.training.cli", "_figures"),
    ),
    Kind("benchmarks", _benchmarks, _mutations.change_json, lambda path: results_page(path.parent)),
)

ATTACKS = tuple(
    Attack(
        f"files-{kind.name}",
        f"A broken file ({kind.name}) is loaded as what it is or refused in one line, quickly and in bounded memory.",
        attack(kind, 20 if "figures" in kind.name else 300),
        memory=6 * 1024**3,
    )
    for kind in KINDS
)
