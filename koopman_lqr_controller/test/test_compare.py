"""The comparisons of thesis 4.3: complete; on a tiny budget they run, share runs, and are plotted."""

import json
import shlex
from contextlib import suppress
from pathlib import Path

import pytest
from koopman_lqr_controller.cli.compare import compare, plot
from koopman_lqr_controller.cli.learn import learn
from koopman_lqr_controller.policies.policy_file import load_policy
from koopman_lqr_controller.training.environments.benchmark_tasks import find_task
from koopman_lqr_controller.training.experiments.comparisons import COMPARISONS
from koopman_lqr_controller.training.experiments.methods import LEARNERS, METHODS
from koopman_lqr_controller.training.experiments.results import collect_comparison

pytestmark = pytest.mark.usefixtures("short_episodes", "runs_here")
TINY = ["--tasks", "cartpole_swingup", "--seeds", "1", "--workers", "1", "--chunks", "1", "--actions", "30"]
TINY += ["--episodes", "1", "--consolidation", "0", "--set", "batch=16", "hidden=16", "latent=6", "first_steps=15"]


@pytest.mark.parametrize("name", COMPARISONS)
def test_a_comparison_names_only_what_there_is(name: str) -> None:
    comparison = COMPARISONS[name]
    for task in comparison.tasks:
        for method in comparison.methods:
            find_task(task).with_settings(**dict(METHODS[method].changes))
            assert METHODS[method].learner in LEARNERS
    assert {task for task, _ in comparison.thesis} <= set(comparison.tasks)
    assert {method for _, method in comparison.thesis} <= set(comparison.methods)


def test_comparisons_run_and_share_their_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    where = ["--folder", str(tmp_path / "runs"), "--results", str(tmp_path)]
    assert compare(["--figure", "4.3", *TINY, *where]) == 0
    (finished,) = (tmp_path / "runs").rglob("result.json")
    before = finished.stat().st_mtime_ns
    assert compare(["--figure", "4.8", *TINY, *where]) == 0
    assert finished.stat().st_mtime_ns == before
    file = tmp_path / "koopman_figure_4.8_cartpole_swingup.json"
    results = json.loads(file.read_text(encoding="utf-8"))
    assert list(results["figures"]["curves"]) == ["koopman", "network", "sac"]
    assert {row["method"] for row in results["rows"]} == {METHODS[name].label for name in ("koopman", "network", "sac")}
    pictures = [tmp_path / f"koopman_figure_{number}_cartpole_swingup.svg" for number in ("4.3", "4.8")]
    assert plot([*(str(each.with_suffix(".json")) for each in pictures), "--output", str(tmp_path)]) == 0
    assert all(picture.stat().st_size > 5000 for picture in pictures)
    assert "task-oriented Koopman" in capsys.readouterr().out


def test_a_few_methods_can_be_compared_and_each_says_how_to_learn_it_again(tmp_path: Path) -> None:
    where = ["--folder", str(tmp_path), "--results", str(tmp_path)]
    assert compare(["--table", "4.3", "--methods", "latent_6", "koopman", *TINY, *where]) == 0
    results = json.loads((tmp_path / "koopman_table_4.3_cartpole_swingup.json").read_text(encoding="utf-8"))
    assert list(results["figures"]["curves"]) == ["latent_6", "koopman"]
    (run,) = tmp_path.rglob("policy.safetensors")  # with these settings both are one run
    policy = load_policy(run)
    command = shlex.split(policy.manifest["command"])
    assert command[:3] == ["ros2", "run", "koopman_lqr_controller"]
    assert learn([*command[4:], "--folder", str(tmp_path / "again")]) == 0
    again = load_policy(next((tmp_path / "again").rglob("policy.safetensors")))
    assert again.controller.K.tolist() == policy.controller.K.tolist()
    assert again.manifest["returns"] == policy.manifest["returns"]


def result(*points: tuple[float, float]) -> dict:
    """Return a run with the given returns and model errors of its evaluations."""
    curve = [
        {"steps": 10 * number, "returns": {"a": value, "b": -1.0}, "model_errors": {"a": error, "b": 1.0}}
        for number, (value, error) in enumerate(points, 1)
    ]
    final = {"returns": [1.0, 3.0], "model_error": 0.1, "error_over_persistence": 0.5}
    return {"curve": curve, **final, "best": {"actions": 3}, "cpu_seconds": 60.0}


def test_a_table_sets_the_thesis_beside_ours() -> None:
    runs = {method: [result((1.0, 0.1))] for method in COMPARISONS["table-4.2"].methods}
    rows, _ = collect_comparison("table-4.2", "cartpole_swingup", runs)
    thesis = {row.method: row.thesis for row in rows if row.metric == "return"}
    assert thesis["two stages, learnt lifting, Q3"] == 70.65
    assert thesis["task-oriented Koopman"] == 846.88
    assert {row.metric for row in rows} >= {"model error", "one-step error over persistence", "CPU time"}
    assert rows[0].values == [2.0]


def test_levels_of_the_model_error_take_the_best_return_at_each() -> None:
    runs = [result((100.0, 1.2e-3), (120.0, 9e-4), (60.0, 1.1e-2)), result((80.0, 1e-3))]
    rows, figures = collect_comparison("table-4.1", "cartpole_swingup", {"two_stage": runs})
    found = {(row.method, row.metric): row for row in rows}
    at = "two stages, learnt lifting, Q1, model error ~1e-0"
    assert found[f"{at}3", "return at this model error"].values == [120.0, 80.0]
    assert found[f"{at}3", "return at this model error"].thesis == 107.67
    assert found[f"{at}2", "less than at the level before"].values == [pytest.approx(40.0)]
    assert found[f"{at}2", "less than at the level before"].thesis == pytest.approx(40.27, abs=0.01)
    assert figures["curves"]["two_stage"] == {"samples": [10, 20, 30], "values": [[100.0, 120.0, 60.0], [80.0] * 3]}
    assert found["two stages, learnt lifting, Q1", "CPU time"].values == [1.0, 1.0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--table", "4.2", "--tasks", "cheetah_run"], "--tasks cheetah_run: table-4.2 is of cartpole_swingup"),
        (["--table", "4.4", "--set", "latnt=3"], "no setting latnt: there are latent, "),
        (["--table", "4.2", "--methods", "sac"], "--methods sac: table-4.2 is of two_stage, two_stage_q2"),
        (
            ["--figure", "4.8", "--tasks", "cartpole_swingup_pixels", "--methods", "sac"],
            "--methods sac: learns from vectors, cartpole_swingup_pixels shows pictures",
        ),
        (["--figure", "4.3", "--seeds", "0"], "--seeds must be a whole number of at least 1, not 0"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with suppress(SystemExit):  # a command line that is refused
        assert compare([*arguments, "--folder", str(tmp_path), "--results", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"compare: {words}")
    assert error.count("\n") == 1


def test_what_compare_did_not_write_is_not_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert plot([str(tmp_path / "none.json"), "--output", str(tmp_path)]) == 1
    assert "there is no such file" in capsys.readouterr().err
