"""Learning end to end on a tiny budget: it resumes exactly and leaves a policy that needs no torch."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from ctrl_rl_core.io import read_json
from ctrl_rl_learning.study import RunOptions, result_file, run_experiments, train
from koopman_lqr_controller.data.roll_outs import evaluate
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.policies.policy_file import digest, load_policy
from koopman_lqr_controller.training.agents.learner import ReplayLearner
from koopman_lqr_controller.training.agents.soft_agent import SoftAgent
from koopman_lqr_controller.training.consolidation.consolidation_config import REPORT_SEED
from koopman_lqr_controller.training.environments.benchmark_tasks import BENCHMARK_TASKS
from koopman_lqr_controller.training.experiments.results import collect_last
from koopman_lqr_controller.training.experiments.runs import LearningRun
from koopman_lqr_controller.training.experiments.trainer import POLICY_FILE
from koopman_lqr_controller.training.replay import Replay
from koopman_lqr_controller.training.settings import Settings
from short_suite import STEPS

from ctrl_rl_learning import LearningError

pytestmark = pytest.mark.usefixtures("short_episodes")
TINY = (("batch", 16), ("first_steps", 15), ("hidden", 16), ("latent", 6))
RUN = LearningRun("cartpole_swingup", 2, TINY, command="learn --task cartpole_swingup", consolidation=0)


def options(folder: Path, chunks: int = 3) -> RunOptions:
    return RunOptions(folder, chunks, 20, 1, 2)


def learnt(folder: Path, run: LearningRun = RUN) -> tuple[dict, bytes]:
    """Return all results of the run except for the time and memory used."""
    result = read_json(result_file(folder, run))
    for point in result["curve"]:
        del point["seconds"], point["cpu_seconds"]
    del result["cpu_seconds"]
    return result, result_file(folder, run).with_name(POLICY_FILE).read_bytes()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict, list]:
    """Return the folder of a complete run, its result, and its output."""
    folder, said = tmp_path_factory.mktemp("whole"), []
    result = train(RUN, options(folder), lambda run, done, best: said.append((run.name, done, best)))
    return folder, result, said


class CutOffError(Exception):
    """Simulated kill between two chunks."""


def cut_off(*_: object) -> None:
    raise CutOffError


OTHERS = (
    replace(RUN, changes=(*TINY, ("policy", "network"))),
    replace(RUN, changes=(*TINY, ("encoder_loss", "reconstruction_prediction"))),
    replace(RUN, changes=(*TINY, ("bfloat16", "all"), ("critic", "plain"))),
    replace(RUN, changes=(*TINY, ("critic", "categorical"), ("reward_steps", 3)), keep="last"),
    replace(
        RUN,
        changes=(*TINY, ("critic_input", "observation"), ("scale", "seen"), ("encoder_loss", "nothing")),
        keep="last",
    ),
    replace(
        RUN,
        changes=(*TINY, ("critic", "model_based"), ("scale", "seen"), ("model_steps", 2), ("renewal", 7), ("depth", 3)),
        keep="last",
    ),
    replace(RUN, learner="sac"),
    replace(RUN, learner="two_stage"),
    replace(RUN, learner="edmd"),
)


@pytest.mark.parametrize("run", OTHERS, ids=lambda run: run.name)
def test_other_ways_of_learning_go_on_exactly_too(run: LearningRun, tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    result = train(run, options(whole, 2))
    with pytest.raises(CutOffError):
        train(run, options(cut, 2), cut_off)
    train(run, options(cut, 2))
    assert learnt(cut, run) == learnt(whole, run)
    assert [point["actions"] for point in result["curve"]] == [20, 40]
    assert result["interaction"]["learning"] == {"episodes": 2, "actions": 40}
    assert len(result["returns"]) == 2
    assert ("model_error" in result) == (run.learner != "sac" and ("policy", "network") not in run.changes)


def test_two_stages_put_the_costs_of_the_thesis_on_the_observation(tmp_path: Path) -> None:
    train(replace(RUN, learner="two_stage", changes=(*TINY, ("cost", "Q4"))), options(tmp_path, 1))
    controller = load_policy(next(tmp_path.rglob(POLICY_FILE))).controller
    x = np.array([0.3, -1.0, 0.1, 2.0, -3.0], np.float32)
    assert controller.latent(x)[:5] == pytest.approx(x)
    assert controller.z_ref[:5].tolist() == [0.0, 1.0, 0.0, 0.0, 0.0]
    assert controller.Q.tolist() == [10.0, 60.0, 60.0, 10.0, 10.0, *[0.1] * 6]
    assert controller.spectral_radius < 1.0


@pytest.mark.parametrize(
    ("run", "words"),
    [
        (replace(RUN, problem_name="cheetah_run", learner="two_stage"), "needs hand-tuned costs"),
        (replace(RUN, changes=(("cost", "Q5"),)), "cost is Q5: must be Q1 or Q2"),
        (
            replace(RUN, changes=(("encoder_loss", "reconstruction_prediction"), ("policy", "network"))),
            "needs a model: policy must be lqr",
        ),
    ],
)
def test_what_cannot_be_learnt_is_refused(run: LearningRun, words: str, tmp_path: Path) -> None:
    with pytest.raises(KoopmanError, match=words):
        train(run, options(tmp_path))


def test_a_run_that_was_cut_off_ends_bit_by_bit_as_if_it_had_not_been(whole: tuple, tmp_path: Path) -> None:
    """Interrupted between chunks, and after the last of them."""
    cut, told = tmp_path / "cut", []

    def cut_off_after_one_more(_: object, done: int, __: object) -> None:
        told.append(done)
        if told.count(done) == 1:
            raise CutOffError

    for _ in range(3):
        with pytest.raises(CutOffError):
            train(RUN, options(cut), cut_off_after_one_more)
    assert told == [1, 1, 2, 2, 3], "where it goes on, and each chunk"
    assert not result_file(cut, RUN).exists()
    train(RUN, options(cut))
    assert learnt(cut) == learnt(whole[0])
    files = {file.name for file in result_file(cut, RUN).parent.iterdir() if "tfevents" not in file.name}
    assert files == {"curve.csv", POLICY_FILE, "result.json"}


def test_a_run_that_was_killed_goes_on_exactly(whole: tuple, tmp_path: Path) -> None:
    killed = tmp_path / "killed"
    program = (
        f"import sys\nsys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "import short_suite\nshort_suite.shorten()\n"
        "from pathlib import Path\n"
        "from ctrl_rl_learning.study import RunOptions, train\n"
        "from koopman_lqr_controller.training.experiments.runs import LearningRun\n"
        f"train({RUN!r}, RunOptions(Path({str(killed)!r}), 3, 20, 1, 2))"
    )
    process = subprocess.Popen([sys.executable, "-c", program])
    checkpoint = result_file(killed, RUN).with_name("checkpoint.safetensors")
    while process.poll() is None and not checkpoint.exists():
        time.sleep(0.005)
    time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    train(RUN, options(killed))
    assert learnt(killed) == learnt(whole[0])


def test_what_is_learnt_is_what_is_evaluated_and_says_where_it_comes_from(whole: tuple) -> None:
    folder, result, said = whole
    assert [done for _, done, _ in said] == [1, 2, 3, 3]
    assert said[-1][2] == "fresh episodes"
    best = result["best"]["return"]
    assert said[-2][2] == f"{best:.1f}"
    assert best == max(max(point["returns"].values()) for point in result["curve"])
    policy = load_policy(result_file(folder, RUN).with_name(POLICY_FILE))
    assert policy.manifest["command"] == RUN.command
    assert policy.manifest["task_digest"] == RUN.problem.digest
    assert policy.manifest["settings"]["latent"] == 6
    assert policy.distribution.mean.shape == (6,), "what learning saw"
    environment = RUN.problem.make(False)
    assert [episode.total for episode in evaluate(policy.controller, environment, 2, REPORT_SEED)] == result["returns"]
    assert evaluate(policy.controller, environment, 1, 1_000_000)[0].total == result["best"]["return"]
    before = result_file(folder, RUN).stat().st_mtime_ns
    assert train(RUN, options(folder)) == result
    assert result_file(folder, RUN).stat().st_mtime_ns == before


@pytest.mark.usefixtures("runs_here")
def test_seeds_are_learnt_one_after_the_other(tmp_path: Path) -> None:
    runs = [replace(RUN, learner="edmd", seed=seed) for seed in range(2)]
    results = run_experiments(runs, options(tmp_path, 1), workers=1)
    assert [result["run"]["seed"] for result in results] == [0, 1]
    assert [result["digests"] for result in results] == [
        {POLICY_FILE: digest(result_file(tmp_path, run).with_name(POLICY_FILE))} for run in runs
    ]


def test_a_run_made_with_other_settings_is_not_taken(whole: tuple, tmp_path: Path) -> None:
    with pytest.raises(CutOffError):
        train(RUN, options(tmp_path), cut_off)
    with pytest.raises(LearningError, match=r"checkpoint\.safetensors: was made with iterations 3, now it is 2: use"):
        train(RUN, options(tmp_path, 2))
    with pytest.raises(LearningError, match=r"result\.json: was made with iterations 3, now it is 2: use"):
        train(RUN, options(whole[0], 2))


@pytest.mark.parametrize("change", [{"evaluations": 2}, {"final_evaluations": 3}])
def test_a_run_that_was_evaluated_otherwise_is_not_taken(change: dict[str, int], whole: tuple) -> None:
    with pytest.raises(LearningError, match=r"result\.json: was made with .*evaluations"):
        train(RUN, replace(options(whole[0]), **change))


def test_what_it_took_is_counted(whole: tuple) -> None:
    _, result, _ = whole
    assert [point["episodes"] for point in result["curve"]] == [1, 2, 3], "chunks of 20 actions, episodes of 25"
    assert result["interaction"]["learning"] == {"episodes": 3, "actions": 60}
    assert result["interaction"]["choosing"] == {"episodes": 6, "actions": 6 * STEPS}


@pytest.mark.parametrize("cut", [False, True])
def test_learning_ends_with_its_episodes(cut: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BENCHMARK_TASKS, RUN.problem_name, replace(BENCHMARK_TASKS[RUN.problem_name], episodes=2))
    longer = RunOptions(tmp_path, 3, 30, 1, 2)
    if cut:
        with pytest.raises(CutOffError):
            train(RUN, longer, cut_off)
    result = train(RUN, longer)
    assert [point["actions"] for point in result["curve"]] == [30], "an episode of 25 actions and one of 5"
    assert result["interaction"]["learning"] == {"episodes": 2, "actions": 30}


def test_a_chunk_may_end_with_its_episodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = replace(BENCHMARK_TASKS[RUN.problem_name], chunk_episodes=1, episodes=3)
    monkeypatch.setitem(BENCHMARK_TASKS, RUN.problem_name, problem)
    result = train(RUN, RunOptions(tmp_path, 4, 60, 1, 2))
    assert [(point["actions"], point["episodes"]) for point in result["curve"]] == [(25, 1), (50, 2), (75, 3)]


def test_updates_may_be_many_or_few(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    counts = []
    monkeypatch.setattr(SoftAgent, "update", lambda agent, *_: counts.append(agent))
    for updates, every in ((3, 1), (2, 5)):
        changes = (*TINY, ("update_every", every), ("updates", updates))
        train(replace(RUN, changes=changes), options(tmp_path, 1))
        assert len(counts) == updates * 5 // every, "20 actions, the first 15 at random"
        counts.clear()


@pytest.mark.parametrize(("first", "updates"), [(0, 185), (30, 169), (999, 50)])
def test_random_actions_go_on_until_the_first_reward_within_a_limit(first: int, updates: int) -> None:
    class Late(gymnasium.Env[np.ndarray, np.ndarray]):
        observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
        steps = 0

        def reset(self, **_: object) -> tuple[np.ndarray, dict]:
            return np.zeros(2, np.float32), {}

        def step(self, _: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
            self.steps += 1
            return np.zeros(2, np.float32), float(self.steps == first + 1), False, self.steps % 50 == 0, {}

    class Counting(ReplayLearner):
        updates = 0

        def _begin(self, _: np.random.Generator) -> tuple:
            return lambda _: np.zeros(1, np.float32), self._update

        def _update(self) -> None:
            self.updates += 1

    problem = replace(BENCHMARK_TASKS["cartpole_swingup"], settings=Settings(first_steps=15), goal=None)
    learner = Counting(problem, Late(), 0)
    learner.replay = Replay(500, (2,), 1, np.float32)
    learner.learn(0, 0, 200, 0)
    assert learner.updates == updates


def test_learning_ends_when_nothing_gets_better(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BENCHMARK_TASKS, RUN.problem_name, replace(BENCHMARK_TASKS[RUN.problem_name], patience=1))
    result = train(RUN, options(tmp_path, 12))
    ends = [point["actions"] for point in result["curve"]]
    assert len(ends) < 12
    assert ends[-2:] == [result["best"]["actions"], result["best"]["actions"] + 20]
    other = train(replace(RUN, learner="edmd"), options(tmp_path, 12))
    assert len(other["curve"]) == 12, "what is not ours gets all of the budget"


def test_the_last_policy_is_kept_whatever_evaluations_say(tmp_path: Path) -> None:
    run = replace(RUN, keep="last")
    result = train(run, options(tmp_path, 3))
    last = result["curve"][-1]
    assert result["best"]["return"] == last["returns"]["averaged"]
    assert result["best"]["actions"] == last["actions"] == 60
    assert result["interaction"]["choosing"] == {"episodes": 0, "actions": 0}
    assert run.name != RUN.name, "its folder is another one"
    rows = collect_last(run.problem, [result])
    assert [(row.method, row.metric) for row in rows] == [("cartpole_swingup", "return at 0.48k frames")]
    assert rows[0].values == [pytest.approx(np.mean(result["returns"]))]
    passed = {**result["curve"][0], "steps": 100_000}
    early, late = collect_last(run.problem, [{**result, "curve": [passed, last]}])
    assert (early.metric, early.values) == ("return at 100k frames", [passed["returns"]["averaged"]])
    assert late.values == rows[0].values
    resumed = {**result, "curve": [{**passed, "returns": dict(reversed(passed["returns"].items()))}, last]}
    assert collect_last(run.problem, [resumed])[0].values == early.values, "checkpoints keep no order"
    again = {**result, "run": {**result["run"], "seed": 7}}
    assert (again_row := collect_last(run.problem, [again])[0]).seeds == (7,)
    assert again_row.terms == rows[0].terms, "seeds are learnt by the same terms"
    other = {**result, "run": {**result["run"], "evaluations": 99}}
    assert collect_last(run.problem, [other])[0].terms != rows[0].terms


def test_a_broken_checkpoint_is_named(tmp_path: Path) -> None:
    checkpoint = result_file(tmp_path, RUN).with_name("checkpoint.safetensors")
    checkpoint.parent.mkdir()
    checkpoint.write_bytes(b"half a file")
    with pytest.raises(LearningError, match=r"checkpoint\.safetensors: .*: cannot resume from it: delete it"):
        train(RUN, options(tmp_path))


def test_a_device_that_is_not_there_is_named(tmp_path: Path) -> None:
    if torch.cuda.is_available():
        pytest.skip("this machine has one")
    with pytest.raises(KoopmanError, match="device cuda: torch sees none; use cpu"):
        train(LearningRun("cartpole_swingup", 0, TINY, "cuda"), options(tmp_path))


def test_learning_needs_no_other_library_of_learning() -> None:
    program = (
        "import sys, koopman_lqr_controller.training.experiments.runs, ctrl_rl_learning.study.matrix\n"
        "sys.exit(any(name in sys.modules for name in ('stable_baselines3', 'pybullet', 'casadi')))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
