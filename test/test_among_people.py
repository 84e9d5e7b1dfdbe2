"""The navigator gets past people who come, and the trial among people says what became of each drive."""

from __future__ import annotations

from pathlib import Path

import pytest
from people.command import line, main, rows
from people.drives import Ride, ride

from ctrl_rl_core import read_results


@pytest.mark.parametrize("kind", ["head-on", "following", "standing"])
def test_it_gets_past_people(kind: str) -> None:
    assert ride(kind, 0, filtered=False).end == "goal"


def test_what_became_of_drives_is_counted() -> None:
    rides = [Ride("goal", False, 20.0, 0.0), Ride("hit", True, 9.0, 0.0), Ride("hit", False, 9.0, 0.0)]
    assert line("navigator", rides).split() == ["navigator", "3", "1", "0", "2", "1"]
    assert {row.metric: sum(row.values) for row in rows("navigator", rides)} == {
        "arrived": 1.0,
        "contacts in motion": 0.0,
        "hit while standing": 2.0,
        "hit while standing, with room to leave": 1.0,
    }


def test_it_writes_a_row_for_each_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["people", "--drives", "1", "--kinds", "following", "--filters", "off"]
    monkeypatch.setattr("sys.argv", [*words, "--output", str(tmp_path / "people.json")])
    assert main() == 0
    (experiment,) = read_results(tmp_path)
    assert {row.method for row in experiment.rows} == {"navigator, following"}


@pytest.mark.parametrize("words", [["--kinds", "dancing"], ["--drives", "0"]])
def test_what_cannot_be_driven_is_one_line(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["people", *words])
    assert main() == 2
    assert capsys.readouterr().err.startswith("people: ")
