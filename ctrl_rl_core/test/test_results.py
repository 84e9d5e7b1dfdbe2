"""Results as files and as a page."""

import json
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from ctrl_rl_core.io.outcome_log import OutcomeLog
from ctrl_rl_core.io.results import Origin, read_experiment, with_others
from ctrl_rl_core.io.results_page import heading, results_page

from ctrl_rl_core import Result, ResultsError, read_benchmarks, read_results, write_results


def test_a_row_carries_its_values_and_their_mean_and_spread(tmp_path: Path) -> None:
    file = tmp_path / "new" / "corridor.json"
    write_results(file, "corridor", [0, 1], [Result("edmd", "time", "s", [2.0, 4.0], thesis=3.5)])
    content = json.loads(file.read_text())
    assert content["experiment"] == "corridor"
    assert content["seeds"] == [0, 1]
    assert content["command"]
    assert content["rows"] == [
        {
            "method": "edmd",
            "metric": "time",
            "unit": "s",
            "values": [2.0, 4.0],
            "mean": 3.0,
            "std": 2.0**0.5,
            "thesis": 3.5,
        }
    ]
    assert [path.name for path in file.parent.iterdir()] == ["corridor.json"]


def test_the_page_sets_each_row_beside_the_thesis(tmp_path: Path) -> None:
    rows = [Result("edmd", "time", "s", [2.0, 4.0], thesis=3.5), Result("edmd", "goal reached", "1", [1.0, 1.0])]
    write_results(tmp_path / "corridor.json", "corridor", [0, 1], rows)
    row = {"name": "look-up", "value": 0.286, "unit": "us", "against": "scipy, 42 us", "ratio": 148.0}
    (tmp_path / "bench.json").write_text(json.dumps([row]))
    page = results_page(tmp_path)
    assert "## Corridor" in page
    assert "2 rows, 2 seeds, mean and sample standard deviation over them; in brackets the thesis's; " in page
    assert "[data](results/corridor.json)" in page
    assert "| method | time [s] | goal reached |" in page
    assert "| edmd | 3 ± 1.4 (3.5) | 1 ± 0 |" in page
    assert "| look-up | 0.286 us | scipy, 42 us | 148 |" in page
    assert read_benchmarks(tmp_path / "missing.json") == []


def test_a_broken_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "half.json").write_text('{"rows": [')
    with pytest.raises(ResultsError, match=r"half\.json: is not valid JSON"):
        read_results(tmp_path)


def test_new_rows_stand_beside_those_of_other_methods(tmp_path: Path) -> None:
    file = tmp_path / "results.json"
    old = [Result("a", "time", "s", [1.0], 2.0), Result("a", "success", "1", [0.5]), Result("b", "time", "s", [3.0])]
    new = [Result("a", "time", "s", [4.0])]
    assert _figures(with_others(file, new)) == new
    write_results(file, "these", [0], old)
    assert _figures(with_others(file, new)) == [old[2], *new]
    assert _figures(with_others(file, new, same_metric=True)) == [*old[1:], *new]
    file.write_text("{")
    with pytest.raises(ResultsError):
        with_others(file, new)


def test_values_of_other_seeds_join_those_that_the_same_terms_made(tmp_path: Path) -> None:
    file = tmp_path / "results.json"

    def row(values: list[float], seeds: tuple[int, ...], terms: str = "a") -> Result:
        return Result("koopman", "return", "1", values, None, seeds, terms)

    write_results(file, "returns", [0, 3], [row([1.0, 4.0], (0, 3))])
    more = with_others(file, [row([2.0, 5.0], (1, 3))], same_metric=True)
    assert _figures(more) == [row([1.0, 2.0, 5.0], (0, 1, 3))], "the new value of seed 3 replaces the old one"
    write_results(file, "returns", [0, 1, 3], more)
    for terms in ("b", ""):
        alone = [row([9.0], (0,), terms)]
        assert _figures(with_others(file, alone, same_metric=True)) == alone
    alone = [row([9.0], (0,))]
    assert _figures(with_others(file, alone)) == alone, "rows of methods are replaced as a whole"
    write_results(file, "returns", [0], [row([1.0, 2.0], (0,))])
    with pytest.raises(ResultsError, match="one per value"):
        with_others(file, [row([9.0], (0,))], same_metric=True)


def _figures(rows: list[Result]) -> list[Result]:
    """Return rows without the command that runs the tests."""
    return [replace(row, origins=()) for row in rows]


def test_each_row_keeps_the_command_and_commit_that_measured_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "returns.json"

    def run(command: str, rows: list[Result]) -> None:
        monkeypatch.setattr("sys.argv", ["bin/train", command])
        write_results(file, "returns", [0, 1], with_others(file, rows, same_metric=True))

    def row(method: str, values: list[float], seeds: tuple[int, ...]) -> Result:
        return Result(method, "return", "1", values, None, seeds, "a")

    run("first", [row("cart", [1.0], (0,)), row("pole", [2.0, 3.0], (0, 1))])
    run("second", [row("cart", [4.0], (1,))])
    run("second", [row("cart", [5.0], (1,))])
    run("third", [row("pole", [6.0, 7.0], (0, 1))])
    (experiment,) = read_results(tmp_path)
    origins = {row.method: row.origins for row in experiment.rows}
    commit = experiment.commit
    assert [each.command for each in origins["cart"]] == ["train first", "train second"]
    assert origins["pole"] == [Origin(command="train third", commit=commit)]
    page = results_page(file.parent)
    assert f"    train second\n\nCommit {commit}: cart.\n" in page
    assert f"    train third\n\nCommit {commit}: pole.\n" in page
    assert "2 rows, 2 seeds, mean and sample standard deviation over them;" in page


def test_a_command_is_kept_without_the_folders_of_one_computer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["/opt/bin/train", "--peer", str(tmp_path / "python"), "--output", "runs/a.json"])
    write_results(tmp_path / "a.json", "Speed", [0], [Result("ours", "speed", "1", [1.0])])
    assert json.loads((tmp_path / "a.json").read_text())["command"] == "train --peer python --output runs/a.json"


def test_rows_whose_command_is_not_known_are_called_older(tmp_path: Path) -> None:
    file = tmp_path / "returns.json"
    known = Result("pole", "return", "1", [2.0], origins=(Origin(command="train", commit="0123abc"),))
    write_results(file, "returns", [0], [Result("cart", "return", "1", [1.0]), known])
    write_results(file, "returns", [0], with_others(file, [Result("rod", "return", "1", [2.0])]))
    assert "The other rows are older." in results_page(tmp_path)


def test_rows_of_one_command_keep_it_beside_those_of_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("cart", "pole"):
        monkeypatch.setattr("sys.argv", ["bin/train", name])
        rows = [Result(name, "return", "1", [1.0])]
        file = tmp_path / "returns.json"
        write_results(file, "returns", [0], with_others(file, rows) if file.exists() else rows)
    content = json.loads(file.read_text())
    assert [(row["method"], row["origins"][0]["command"]) for row in content["rows"]] == [
        ("cart", "train cart"),
        ("pole", "train pole"),
    ]


@pytest.mark.parametrize(
    ("stem", "words"),
    [
        ("koopman_figure_4.3_cheetah_run", "Koopman control, figure 4.3: cheetah run"),
        ("oc_training_quad_trap", "Learning with an optimal-control baseline: quadrotor trap"),
        ("ttr_training_car_ttr", "Learning by the time to reach: car"),
        ("barn", "BARN"),
    ],
)
def test_headings_are_words(stem: str, words: str) -> None:
    assert heading(stem) == words


ADD = """
import sys
from pathlib import Path
from ctrl_rl_core.io.results import Result, add_results
for k in range(40):
    add_results(Path(sys.argv[1]), "shared", [0], [Result(f"{sys.argv[2]} {k}", "success", "1", [float(k)])])
"""


def test_two_commands_that_write_one_file_lose_no_row(tmp_path: Path) -> None:
    file = tmp_path / "shared.json"
    both = [subprocess.Popen([sys.executable, "-c", ADD, file, name]) for name in ("one", "two")]
    assert [each.wait(timeout=60) for each in both] == [0, 0]
    kept = read_experiment(file)
    assert kept is not None
    assert {row.method for row in kept.rows} == {f"{name} {k}" for name in ("one", "two") for k in range(40)}


@dataclass(frozen=True)
class Drive:
    world: int
    way: float


def test_every_change_of_an_outcome_log_is_noticed(tmp_path: Path) -> None:
    file = tmp_path / "log.jsonl"
    log = OutcomeLog(file, {"seed": 1}, Drive, ResultsError)
    for k in range(4):
        log.add(Drive(k, 1.0 + k))
    whole = file.read_bytes()
    lines = whole.splitlines(keepends=True)
    assert OutcomeLog(file, {"seed": 1}, Drive, ResultsError).outcomes == log.outcomes
    changed = [whole[:at] + bytes((whole[at] ^ 1 << at % 7,)) + whole[at + 1 :] for at in range(len(whole) - 1)]
    changed += [b"".join(lines[:2] + lines[3:]), b"".join([*lines[:2], lines[3], lines[2]])]
    taken = []
    for content in changed:
        file.write_bytes(content)
        try:
            found = OutcomeLog(file, {"seed": 1}, Drive, ResultsError).outcomes
        except ResultsError:
            continue
        taken += [] if found == log.outcomes[: len(found)] else [content]
    assert not taken


def test_one_process_at_a_time_adds_outcomes(tmp_path: Path) -> None:
    file = tmp_path / "log.jsonl"
    first = OutcomeLog(file, {}, Drive, ResultsError)
    second = OutcomeLog(file, {}, Drive, ResultsError)
    first.add(Drive(0, 1.0))
    with pytest.raises(ResultsError, match="another call adds to it"):
        second.add(Drive(0, 1.0))
    del first
    with pytest.raises(ResultsError, match="another call adds to it"):  # it has added what this one does not know
        second.add(Drive(0, 1.0))
    third = OutcomeLog(file, {}, Drive, ResultsError)
    third.add(Drive(1, 2.0))
    assert third.outcomes == [Drive(0, 1.0), Drive(1, 2.0)]
