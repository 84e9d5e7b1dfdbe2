"""The commands `train` and `consolidate` end to end, and their one-line errors."""

import json
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from koopman_lqr_controller.cli.compare import plot
from koopman_lqr_controller.cli.learn import consolidate, learn, train
from koopman_lqr_controller.policies.latent_policy import LatentPolicy
from koopman_lqr_controller.policies.policy_file import find_policy, load_policy
from koopman_lqr_controller.training.experiments.trainer import CONSOLIDATED_FILE, POLICY_FILE

pytestmark = pytest.mark.usefixtures("short_episodes", "runs_here")
TINY = ["--set", "batch=16", "hidden=16", "latent=6", "first_steps=15", "--chunks", "2", "--actions", "30"]
TINY += ["--episodes", "3", "--consolidation", "5"]


@pytest.fixture(scope="module")
def learnt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    where = ["--folder", str(folder), "--results", str(folder / "results.json")]
    assert learn(["--task", "cartpole_swingup", "--workers", "1", *where, *TINY]) == 0
    return folder


def test_a_run_leaves_policies_and_results(learnt: Path, tmp_path: Path) -> None:
    results = json.loads((learnt / "results.json").read_text(encoding="utf-8"))
    assert results["experiment"] == "koopman_cartpole_swingup"
    rows = {(row["method"], row["metric"]): row for row in results["rows"]}
    assert rows["task-oriented Koopman", "return"]["thesis"] == 846.88
    consolidated = "task-oriented Koopman, consolidated"
    assert all(len(row["values"]) == 1 for row in rows.values())
    assert max(rows[consolidated, "spectral radius of A - B K"]["values"]) < 1.0
    assert max(rows[consolidated, "Riccati residual"]["values"]) < 1e-8
    assert [len(curve) for curve in results["figures"]["curves"]["steps"]] == [2]
    assert plot([str(learnt / "results.json"), "--output", str(tmp_path)]) == 0
    assert (tmp_path / "results.svg").stat().st_size > 10_000
    folders = sorted(folder for folder in learnt.iterdir() if folder.is_dir())
    assert len(folders) == 1
    for folder in folders:
        for name, horizon in ((POLICY_FILE, 5), (CONSOLIDATED_FILE, None)):
            policy = load_policy(folder / name)
            assert isinstance(policy, LatentPolicy)
            assert policy.controller.horizon == horizon
            command = policy.manifest["command"]
            assert "train --task cartpole_swingup --set batch=16" in command
            assert command.endswith("--chunks 2 --actions 30 --episodes 3 --consolidation 5 --first-seed 0")


def test_each_seed_has_a_value_a_curve_and_a_folder(tmp_path: Path) -> None:
    where = ["--folder", str(tmp_path / "runs"), "--results", str(tmp_path / "results.json")]
    short = ["--chunks", "1", "--actions", "20", "--episodes", "1", "--set", "hidden=16", "latent=6"]
    assert train(["--task", "cartpole_swingup", "--learner", "edmd", "--seeds", "2", *where, *short]) == 0
    results = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert results["rows"]
    assert all(len(row["values"]) == 2 for row in results["rows"])
    assert [len(curve) for curve in results["figures"]["curves"]["steps"]] == [1, 1]
    assert sorted(folder.name[-3:] for folder in (tmp_path / "runs").iterdir() if folder.is_dir()) == ["-s0", "-s1"]


def test_calls_with_different_seeds_fill_one_file(tmp_path: Path) -> None:
    file = tmp_path / "results.json"
    short = ["--actions", "20", "--samples", "20", "--episodes", "1", "--consolidation", "0", "--keep", "last"]
    small = ["--set", "hidden=16", "latent=6", "batch=16", "first_steps=10", "updates=1"]
    for number, words in enumerate((["--first-seed", "2"], ["--seeds", "2"])):  # as on two machines
        where = ["--folder", str(tmp_path / str(number)), "--results", str(file)]
        assert train(["--task", "cartpole_swingup", *words, *short, *where, *small]) == 0
    results = json.loads(file.read_text(encoding="utf-8"))
    assert results["seeds"] == results["rows"][0]["seeds"] == [0, 1, 2]
    assert len(results["rows"]) == 1
    assert len(results["rows"][0]["values"]) == 3
    curves = results["figures"]["last_policies"]["cartpole_swingup"]
    assert curves["seeds"] == [0, 1, 2]
    assert curves["curve"]["samples"] == [160.0], "20 actions of eight frames"
    assert [len(values) for values in curves["curve"]["values"]] == [1, 1, 1]
    assert plot([str(file), "--output", str(tmp_path)]) == 0
    assert (tmp_path / "results.svg").stat().st_size > 10_000
    assert next((tmp_path / "0").glob("*-s*")).name.endswith("-s2")


def test_a_results_file_with_other_curves_is_refused_before_learning(
    learnt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = ["--results", str(learnt / "results.json"), "--folder", str(tmp_path / "runs")]
    before = (learnt / "results.json").read_bytes()
    assert train(["--task", "cartpole_swingup", "--keep", "last", *other, *TINY]) == 1
    assert "results.json: holds other curves than those of `train --keep last`: name another" in capsys.readouterr().err
    assert (learnt / "results.json").read_bytes() == before
    assert not (tmp_path / "runs").exists()


def test_a_recipe_is_where_settings_begin(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = ["--actions", "20", "--samples", "20", "--episodes", "1", "--consolidation", "0", "--folder", str(tmp_path)]
    small = ["--set", "hidden=16", "latent=6", "batch=16", "first_steps=10", "updates=1"]
    assert train(["--task", "cheetah_run", "--recipe", "quick", *short, *small]) == 0
    policy = load_policy(next(tmp_path.glob("*-s0")) / POLICY_FILE)
    settings = policy.manifest["settings"]
    assert (settings["critic_input"], settings["scale"], settings["updates"]) == ("observation", "seen", 1)
    assert "--recipe quick" in policy.manifest["command"]
    assert policy.controller.encoder.unit.shape == (17,)
    capsys.readouterr()
    assert train(["--task", "cartpole_swingup_pixels", "--recipe", "quick", *short]) == 1
    assert capsys.readouterr().err.endswith("critic_input must be latent and scale task: this task shows pictures\n")


def test_a_finished_run_is_taken_only_as_it_was_left(
    learnt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "runs"
    shutil.copytree(learnt, folder)
    run = next(folder.glob("*-s0"))
    again = ["--task", "cartpole_swingup", "--folder", str(folder), *TINY]
    before = (run / "result.json").stat().st_mtime_ns
    assert learn(again) == 0
    said = capsys.readouterr().err
    assert "learn still works; its new name is train" in said
    assert "--chunks still works; its new name is --samples" in said
    assert (run / "result.json").stat().st_mtime_ns == before
    (run / CONSOLIDATED_FILE).write_bytes(b"another")
    capsys.readouterr()
    assert learn(again) == 1
    assert "result.json: was made with consolidated.safetensors " in capsys.readouterr().err
    assert train([*again, "--consolidation", "6"]) == 1
    assert "result.json: was made with consolidation " in capsys.readouterr().err


def test_consolidating_again_by_command(learnt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    policy = next(learnt.glob("*-s0")) / POLICY_FILE
    output = tmp_path / "again.safetensors"
    given = [str(policy), "--output", str(output), "--latent", "3", "--episodes", "3", "--live", "5"]
    assert consolidate(given) == 0
    assert "latent dimensions    3" in capsys.readouterr().out
    again = load_policy(output)
    assert len(again.controller.Q) == 3
    words = "consolidate policy.safetensors --output again.safetensors --latent 3 --episodes 3 --live 5"
    assert again.manifest["command"].endswith(words), "and not where the files were"
    assert consolidate(given) == 1
    assert "exists: give another name" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--set", "latnt=3"], "train: no setting latnt: there are latent, "),
        (["--set", "latnt=3", "--set", "latent=4"], "train: no setting latnt: there are latent, "),
        (["--set", "latent"], "train: --set latent: must be NAME=VALUE"),
        (["--set", "latent=many"], "train: latent is 'many': must be a whole number"),
        (["--set", "policy=best"], "train: policy is best: must be lqr or network"),
        (["--set", "latent=3.5"], "train: latent is 3.5: must be a whole number"),
        (["--set", "discount=2"], "train: discount is 2.0: must be at most 1"),
        (["--set", "noise=nan"], "train: noise is nan: must be positive"),
        (["--set", "learning_rate=1e999"], "train: learning_rate is inf: must be positive"),
        (["--set", "first_steps=0"], "train: first_steps is 0: must be positive"),
        (["--set", "replay=1"], "train: replay is 1: must be at least 100"),
        (["--set", "crop=64"], "train: crop is 64: must be 0, this task shows none"),
        (["--seeds", "0"], "train: --seeds must be a whole number of at least 1, not 0"),
        (["--chunks", "-1"], "train: --chunks must be a whole number of at least 0, not -1"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with suppress(SystemExit):  # a command line that is refused
        assert train(["--task", "cheetah_run", "--folder", str(tmp_path), *arguments]) == 1
    error = capsys.readouterr().err
    assert error.startswith(words)
    assert error.count("\n") == 1


def test_a_policy_that_was_not_learnt_here_cannot_be_consolidated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = ["--output", str(tmp_path / "out.safetensors")]
    assert consolidate([str(find_policy("curved_corridor_edmd")), *output]) == 1
    assert "is a policy of fixed observables" in capsys.readouterr().err
    for policy, *more in (
        ("none.safetensors",),
        (str(find_policy("curved_corridor")), "--seed", "-1"),
        (str(find_policy("curved_corridor")), "--noise", "inf"),
        (str(find_policy("curved_corridor")), "--latent", "0"),
    ):
        with suppress(SystemExit):
            assert consolidate([str(tmp_path / policy), *output, *more]) == 1
        assert capsys.readouterr().err.count("\n") == 1


def test_help_comes_without_torch() -> None:
    program = (
        "import sys\nfrom koopman_lqr_controller.cli.learn import train\n"
        "try: train(['--help'])\nexcept SystemExit: sys.exit('torch' in sys.modules)"
    )
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert answer.returncode == 0
    assert "curved_corridor" in answer.stdout
