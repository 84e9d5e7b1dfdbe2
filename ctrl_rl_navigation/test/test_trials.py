"""The command that drives random goals: its counts, its output, and rejected input."""

import sys
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_navigation.cli.trials import main

from ctrl_rl_core import OccupancyMap, read_results


@pytest.fixture
def closet(tmp_path: Path) -> Path:
    """Write the map of a room of 2.5 m by 2 m with a closed closet of half its size."""
    cells = np.zeros((44, 84), np.int8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:], cells[:, 52:54] = (100,) * 5
    OccupancyMap(cells, 0.05).save(tmp_path / "closet.yaml")
    return tmp_path / "closet.yaml"


def run(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    monkeypatch.setattr(sys, "argv", ["trials", *map(str, words)])
    return main()


def test_it_counts_drives_and_keeps_the_rows_of_other_maps(
    closet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tmp_path / "out" / "navigator.json"
    log = ("--folder", tmp_path / "runs")
    words = ("--goals", 6, "--seed", 2, "--results", results, *log)
    assert run(monkeypatch, "--maps", f"closet={closet}", *words) == 0
    told = capsys.readouterr().out
    assert "closet 6/6: " in told
    (experiment,) = read_results(results.parent)
    figures = {row.metric: row for row in experiment.rows}
    assert figures["arrived"].mean == 1.0
    assert figures["collisions"].mean == 0.0
    assert figures["unreachable said"].mean == 1.0
    assert len(figures["arrived"].values) + len(figures["unreachable said"].values) == 6
    assert 0.8 < figures["time over optimal"].mean < 2.0
    assert run(monkeypatch, "--maps", f"again={closet}", "--goals", 1, "--results", results, *log) == 0
    (experiment,) = read_results(results.parent)
    assert {row.method for row in experiment.rows} == {"closet, pybullet", "again, pybullet"}


def test_an_interrupted_run_goes_on_where_it_was(
    closet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--maps", f"closet={closet}", "--seed", 2, "--folder", tmp_path)
    assert run(monkeypatch, *words, "--goals", 3) == 0
    log = tmp_path / "closet-pybullet.jsonl"
    before = log.read_text()
    log.write_text(before[:-20])  # a kill in the middle of a line
    capsys.readouterr()
    assert run(monkeypatch, *words, "--goals", 3) == 0
    assert [line[:12] for line in capsys.readouterr().out.splitlines()] == ["closet 3/3: ", "closet: arri"]
    assert len(log.read_text().splitlines()) == len(before.splitlines()) == 4
    assert run(monkeypatch, *words, "--goals", 3, "--drift", 0.1) == 1
    assert "has drives with other settings" in capsys.readouterr().err
    log.write_text(before.replace("{", "[", 2))
    assert run(monkeypatch, *words, "--goals", 3) == 1
    assert "closet-pybullet.jsonl: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--maps", "nowhere"), "no map 'nowhere': there are corridor, maze, warehouse"),
        (("--maps", "office=none.yaml"), "none.yaml: there is no such file"),
        (("--maps", "../office=none.yaml"), "the name before '=' must consist of"),
        (("--drift", "nan"), "must be finite"),
    ],
)
def test_what_does_not_serve_is_refused_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str
) -> None:
    assert run(monkeypatch, *words, "--goals", "1") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("trials: ")
    assert said in line
