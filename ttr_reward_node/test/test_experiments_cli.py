"""The command `ttr_experiments`: errors are reported before any measurement; figures and pictures are written."""

import json
from functools import partial

import pytest
from ttr_reward_node.cli.experiments import main
from ttr_reward_node.verification.cost import measure_cost


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["check", "--picture", "a.png"], "check draws no picture: leave --picture out"),
        (["convergence", "--picture", "a.png"], "convergence draws no picture: leave --picture out"),
        (["cost", "--output", "no/such/a.json"], "--output no/such/a.json: no/such is no folder to write to"),
        (["gap", "--picture", "no/such/a.png"], "--picture no/such/a.png: no/such is no folder to write to"),
        (["gap", "--output", "."], "--output . is a folder: name a file"),
    ],
)
def test_what_is_wrong_is_said_first(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 1
    said = capsys.readouterr()
    assert words in said.err
    assert said.err.count("\n") == 1
    assert not said.out
    assert not list(tmp_path.iterdir())


def test_cost_is_written_and_drawn(capsys, tmp_path, monkeypatch):
    few = partial(measure_cost, ("3D Dubins car",), (1e3, 1e4, 3e4))
    monkeypatch.setattr("ttr_reward_node.verification.cost.measure_cost", few)
    output, picture = tmp_path / "cost.json", tmp_path / "cost.png"
    assert main(["cost", "--output", str(output), "--picture", str(picture)]) == 0
    rows = json.loads(output.read_text(encoding="utf-8"))["rows"]
    assert [row["metric"] for row in rows] == ["CPU time", "sweeps"] * 3 + ["exponent of the points, 1 is linear"]
    assert picture.stat().st_size > 10_000
    said = capsys.readouterr().out
    assert said.index("figures") < said.index("picture")
