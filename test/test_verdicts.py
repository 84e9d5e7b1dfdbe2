"""The benchmark of verdicts: worlds and files that differ in what they should, and one world judged whole."""

from __future__ import annotations

from pathlib import Path

import pytest
from ctrl_rl_core.io import read_json
from verdicts.command import KINDS, Judged, main, table
from verdicts.worlds import DIFFERENCES, draw_pair, kind_of

from ctrl_rl_core import load_navigation_task


def test_every_second_world_is_as_its_file_says() -> None:
    kinds = [kind_of(seed) for seed in range(16)]
    assert kinds[::2] == ["alike"] * 8
    assert tuple(kinds[1::2]) == DIFFERENCES


@pytest.mark.parametrize("kind", KINDS)
def test_a_world_differs_from_its_file_in_one_way(kind: str, tmp_path: Path) -> None:
    pair = draw_pair(3, tmp_path / "one", kind)
    again = draw_pair(3, tmp_path / "other", kind)
    assert (pair.believed, pair.recorded) == (again.believed, again.recorded)
    fields = type(pair.believed).model_fields
    differing = {name for name in fields if getattr(pair.believed, name) != getattr(pair.recorded, name)}
    own = {"period": {"episode"}, "delay": {"randomisation"}, "lidar": {"lidar"}, "movers": {"movers"}}
    assert differing == {"alike": set(), **own}.get(kind, {"obstacles"})
    assert pair.driven.episode == pair.believed.episode


def test_a_policy_that_is_wrongly_called_better_is_marked() -> None:
    def judged(verdict: str, gain: float, success: float) -> Judged:
        return Judged(0, "alike", "some", verdict, gain, (success, 0.5), 200.0, "")

    each = [judged("better", 300.0, 0.9), judged("better", 300.0, 0.4), judged("not shown", 300.0, 0.9)]
    assert [one.is_much_better for one in each] == [True, False, True]
    assert table(each).splitlines()[1].split() == ["alike", "1", "3", "2", "1", "2", "1", "0"]


@pytest.mark.slow
def test_command_judges_a_world_and_writes_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    output = tmp_path / "verdicts.json"
    words = ["--count", "1", "--episodes", "12", "--tests", "6", "--updates", "60", "--output", str(output)]
    words += ["--work", str(tmp_path / "work")]
    monkeypatch.setattr("sys.argv", ["verdicts", *words])
    assert main() == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum(" 0 alike " in line for line in lines) == 8
    rows = {(row["method"], row["metric"]): row["values"] for row in read_json(output)["rows"]}
    assert len(rows["alike", "called better"]) == 8
    monkeypatch.setattr("verdicts.command.judge_world", None)
    assert main() == 0, "what was judged is not judged again"
    assert capsys.readouterr().out.splitlines() == lines


def test_the_task_files_of_worlds_are_written_for_other_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["verdicts", "--count", "2", "--seed", "7", "--write", str(tmp_path / "tasks")])
    assert main() == 0
    tasks = [load_navigation_task(file) for file in capsys.readouterr().out.split()]
    assert [task.name for task in tasks] == ["drawn_7", "drawn_8"]
    assert tasks[1].obstacles == draw_pair(8, tmp_path / "pair").believed.obstacles


@pytest.mark.parametrize("words", [["--kind", "colour"], ["--count", "0"]])
def test_command_refuses(words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["verdicts", *words])
    assert main() == 2
    assert capsys.readouterr().err.startswith("verdicts: ")
