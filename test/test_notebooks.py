"""The notebooks of docs/notebooks run from the first cell to the last, each in a folder of its own."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from preloaded import Preloaded

LESS = {
    "bag_to_policy": (("episodes=60", "episodes=12"), ("updates=1500", "updates=50"), ("range(20)", "range(2)")),
    "own_reward": (("samples=20_480", "samples=1_024"), ("range(20)", "range(4)")),
}
"""Budgets of notebooks that learn, and smaller ones of a quick test, which judges no success."""
NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "docs" / "notebooks").glob("*.ipynb"))


def code_of(notebook: Path) -> str:
    """Return a notebook's code, one cell after the other."""
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    return "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")


def test_there_are_notebooks_without_outputs() -> None:
    assert len(NOTEBOOKS) >= 4
    for notebook in NOTEBOOKS:
        assert all(not cell.get("outputs") for cell in json.loads(notebook.read_text("utf-8"))["cells"])


def run(code: str, folder: Path) -> None:
    script = folder / "cells.py"
    script.write_text("import matplotlib\nmatplotlib.use('Agg')\n" + code, "utf-8")
    pipe = subprocess.PIPE
    process = Preloaded([sys.executable, script], cwd=folder, stdout=pipe, stderr=pipe, text=True)
    _, errors = process.communicate()
    assert process.returncode == 0, errors


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda notebook: notebook.stem)
def test_a_notebook_runs(notebook: Path, tmp_path: Path) -> None:
    code, less = code_of(notebook), LESS.get(notebook.stem, ())
    for words, fewer in less:
        assert words in code
        code = code.replace(words, fewer)
    if less:
        code = re.sub(r"^assert .*$", "", code, flags=re.MULTILINE)
    run(code, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", LESS)
def test_a_notebook_that_learns_succeeds(name: str, tmp_path: Path) -> None:
    (notebook,) = (each for each in NOTEBOOKS if each.stem == name)
    run(code_of(notebook), tmp_path)
