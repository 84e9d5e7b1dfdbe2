"""From recorded drives alone to policies: fit, evaluate, learn; on a real drive too, if available."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from koopman_lqr_controller.cli.edmd import main as train
from koopman_lqr_controller.cli.offline import evaluate, fit, learn_offline
from koopman_lqr_controller.identification.evaluation import time_step_mismatch
from koopman_lqr_controller.models.encoder import Dense
from koopman_lqr_controller.training.agents.imitation import ImitationSettings, imitate
from koopman_lqr_controller.training.analysis.true_system import StraightCorridor
from recorded import KINDS, Bag

from ctrl_rl_core import read_results
from koopman_lqr_controller import (
    Encoder,
    KoopmanError,
    LatentController,
    LatentPolicy,
    LidarObservation,
    LinearModel,
    RobotInterface,
    TrajectorySegment,
    evaluate_policy,
    find_policy,
    load_policy,
    refit,
    save_policy,
)

CORRIDOR = StraightCorridor(0.7, 0.2)
OBSERVATION = LidarObservation(count=12)
LIMITS = np.array([0.0, -1.0]), np.array([0.22, 1.0])


def driven(steps: int, seed: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the states (steps + 1) and commands of a driver that keeps to the centre on slippery ground."""
    random = np.random.default_rng(seed)
    state, states, commands = np.array([0.1, 0.0, 0.15, 0.0]), [], []
    for _ in range(steps + 1):
        states.append(state)
        turn = -3.0 * state[0] - 1.5 * state[1] + 0.1 * random.normal()
        command = np.clip([0.15 - 0.3 * (state[2] - 0.15) + 0.02 * random.normal(), turn], *LIMITS)
        commands.append(command)
        slip = np.array([0.0, 0.1, 0.02, 0.1]) * random.normal(size=4)
        state = CORRIDOR.step(state, command) + slip
    return states, np.array(commands)


def seen(steps: int = 300, seed: int = 0) -> TrajectorySegment:
    states, commands = driven(steps, seed)
    x = [OBSERVATION.observe(CORRIDOR.scan(s), CORRIDOR.geometry, s[2], s[3]) for s in states]
    return TrajectorySegment(np.array(x), commands[:-1], CORRIDOR.dt)


def some_policy(task: str = "curved_corridor") -> LatentPolicy:
    """Return a policy whose latent is a mixture of the observation, with a meaningless model."""
    random, n = np.random.default_rng(3), 4
    inputs = len(OBSERVATION.names)
    one = np.ones(1, np.float32)
    encoder = Encoder(
        (Dense(random.normal(size=(n, inputs)).astype(np.float32), one * 0, False),), (inputs,), 0 * one, one
    )
    model = LinearModel(0.5 * np.eye(n), 0.1 * random.normal(size=(n, 2)))
    controller = LatentController(encoder, model, np.ones(n), np.ones(2), np.zeros(n), 3)
    return LatentPolicy(controller, 0.2, RobotInterface(OBSERVATION, *LIMITS), {"task": task, "returns": [1.0]})


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return two drives with a lidar whose number of beams varies."""
    folders = []
    for seed in range(2):
        folders.append(tmp_path_factory.mktemp("bags") / f"drive_{seed}")
        kinds = {name: kind for name, kind in KINDS.items() if name != "/episode"}
        states, commands = driven(150, seed)
        random = np.random.default_rng(seed)
        with Bag(folders[-1], kinds) as bag:
            for k, (state, command) in enumerate(zip(states, commands, strict=True)):
                exact = CORRIDOR.scan(state)
                beams = 268 + k % 7
                ranges = exact[(np.arange(beams) * len(exact) / beams).astype(int)]
                ranges[random.random(beams) < 0.02] = np.nan
                bag.put_step(k, ranges.astype(np.float32), state[2:], command)
    return folders


def test_a_lidar_that_sees_only_ahead_fits_a_policy_whose_rear_observables_stay_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A field of view of 240 degrees, like the real recordings' Hokuyo: rear sectors always read maximum range."""
    states, commands = driven(300, 0)
    random = np.random.default_rng(0)
    with Bag(tmp_path / "bag", {name: kind for name, kind in KINDS.items() if name != "/episode"}) as bag:
        for k, (state, command) in enumerate(zip(states, commands, strict=True)):
            exact = CORRIDOR.scan(state)
            ranges = (exact + random.normal(0.0, 0.01, len(exact))).astype(np.float32)
            bearing = np.arange(len(ranges)) * 2 * np.pi / len(ranges)
            ranges[(bearing > np.deg2rad(120.0)) & (bearing < np.deg2rad(240.0))] = np.nan
            bag.put_step(k, ranges, state[2:], command)
    output = tmp_path / "fitted.safetensors"
    assert fit(["curved_corridor_edmd", str(tmp_path / "bag"), "--output", str(output)]) == 0
    said = capsys.readouterr()
    assert "never changed, so the model leaves them out" in said.out
    assert "nearness left - right at 170 deg" in said.out
    policy = load_policy(output)
    rear = [policy.observables.names.index(name) for name in policy.manifest["constant_observables"]]
    assert not policy.model.A[rear].any()
    assert not policy.K[:, rear].any()
    assert policy.K[1].any(), "it steers by what it sees"


def test_without_bags_a_policy_is_evaluated_in_episodes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results = tmp_path / "results.json"
    assert evaluate(["curved_corridor", "--episodes", "2", "--seed", "4", "--results", str(results)]) == 0
    assert re.search(r"episodes   2 of curved_corridor, from seed 4\nsuccess .*\nreturn ", capsys.readouterr().out)
    rows = {row.metric: row.values for row in read_results(tmp_path)[0].rows}
    assert len(rows["success"]) == len(rows["return"]) == 2
    assert evaluate(["curved_corridor_edmd"]) == 1
    assert "this needs one that `learn` made" in capsys.readouterr().err


def test_a_refitted_policy_predicts_and_does_what_the_first_did() -> None:
    learnt, drive, fresh = some_policy(), seen(), seen(200, seed=5)
    assert evaluate_policy(learnt, [fresh])["over_persistence"][0] > 1.0
    once = refit(learnt, [drive.cut(0, 200), drive.cut(200, 300)], sizes=(3,))
    assert once.controller.projection is not None
    twice = refit(once, [seen(seed=1)])
    for before, found in ((learnt, once), (once, twice)):
        assert evaluate_policy(found, [fresh])["over_persistence"][0] < 0.9
        assert found.controller.horizon is None
        assert found.controller.spectral_radius < 1.0
        assert len(found.controller.Q) == 3
        assert found.distribution is not None
        assert found.distribution.relative_distance(found.controller.latent(fresh.x[100])) < 1.5
        done, wanted = (each.controller.action(fresh.x) for each in (found, before))
        missed = np.sqrt(np.mean((done - wanted) ** 2))
        assert missed < 0.5 * np.sqrt(np.mean(wanted**2))
        assert found.manifest["action_difference"] == pytest.approx(missed, rel=0.5), "on other drives"


def test_agreement_is_whole_for_a_policy_that_was_recorded_itself() -> None:
    policy, drive = some_policy(), seen(50)
    u = policy.robot_interface.command(policy.controller.action(drive.x[:-1]))
    found = evaluate_policy(policy, [TrajectorySegment(drive.x, u, 0.2)])
    assert [each["explained"] for each in found["commands"].values()] == pytest.approx([1.0, 1.0])
    other = evaluate_policy(policy, [TrajectorySegment(drive.x, u[::-1], 0.2)])
    assert other["commands"]["turn rate [rad/s]"]["explained"] < 1.0
    with pytest.raises(KoopmanError, match="no steps"):
        evaluate_policy(policy, [])


def test_two_stages_are_fitted_and_evaluated_by_command(
    bags: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "fitted.safetensors"
    given = ["curved_corridor_edmd", *map(str, bags), "--output", str(output)]
    assert fit(given) == 0
    fitted = load_policy(output)
    assert fitted.manifest["drives"]["held out"]["over_persistence"][0] < 1.0
    assert fitted.manifest["bags"] == ["drive_0", "drive_1"]
    assert fitted.dt == pytest.approx(0.2)
    assert "snapshots" not in fitted.manifest, "these would be of the fitted part alone"
    assert np.array_equal(fitted.u_high, load_policy(find_policy("curved_corridor_edmd")).u_high)
    assert fit(given) == 1
    assert "exists: give another name" in capsys.readouterr().err
    assert evaluate([str(output), *map(str, bags), "--results", str(tmp_path / "figures.json")]) == 0
    out = capsys.readouterr().out
    assert evaluate([str(output), *map(str, bags), f"--json={tmp_path / 'again.json'}"]) == 0
    assert "evaluate: --json still works; its new name is --results\n" in capsys.readouterr().err
    assert (tmp_path / "again.json").read_text("utf-8") == (tmp_path / "figures.json").read_text("utf-8")
    assert "held out      60 steps: error 0." in out
    figures = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert figures == json.loads(json.dumps(fitted.manifest["drives"]))
    # What the policy has not seen is held out from it, however the call would split; the first file says nothing.
    assert evaluate([str(output), str(bags[0]), "--held-out", "0.5"]) == 0
    assert "held out" not in capsys.readouterr().out
    assert evaluate(["curved_corridor_edmd", str(bags[0])]) == 0
    assert "does not say which drives it was fitted to" in capsys.readouterr().out


def test_two_stages_are_trained_by_command(
    bags: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for held_out, counts, judged in (("0.25", "112 fitted, 38 held out", "held out"), ("0", "150 fitted, 0", "fitted")):
        output = tmp_path / f"{judged}.safetensors"
        assert train([str(bags[0]), "--output", str(output), "--held-out", held_out, "--lidar-yaw", "0"]) == 0
        out = capsys.readouterr().out
        assert counts in out
        assert f"of that of 'nothing changes' ({judged})" in out
        assert load_policy(output).dt == pytest.approx(0.2)
    with pytest.raises(SystemExit):
        train([str(bags[0]), "--output", str(tmp_path), "--overwrite"])
    assert f"{tmp_path} is a folder: name a file in it" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        evaluate(["curved_corridor", str(bags[0]), "--lidar-yaw", "nan"])
    assert "'nan' is not a finite number" in capsys.readouterr().err


def test_drives_with_another_step_than_the_model_s_are_told(
    bags: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = some_policy()
    slow = LatentPolicy(policy.controller, 0.4, policy.robot_interface, policy.manifest)
    assert time_step_mismatch(policy, [seen(20)]) == ""
    assert time_step_mismatch(slow, [seen(20)]).startswith("The model's step is 0.40 s, that of the drives 0.20 s")
    save_policy(slow, tmp_path / "slow.safetensors")
    assert evaluate([str(tmp_path / "slow.safetensors"), str(bags[0])]) == 0
    assert "The model's step is 0.40 s" in capsys.readouterr().out


def test_a_latent_policy_is_learnt_from_bags_alone(bags: list[Path], tmp_path: Path) -> None:
    output = tmp_path / "learnt.safetensors"
    given = [*map(str, bags), "--output", str(output), "--latent", "6", "--updates", "300", "--held-out", "0.25"]
    assert learn_offline(given) == 0
    learnt = load_policy(output)
    assert isinstance(learnt, LatentPolicy)
    assert learnt.distribution is not None
    assert learnt.dt == pytest.approx(0.2)
    figures = learnt.manifest["drives"]
    assert figures["held out"]["over_persistence"][0] < 1.0
    assert figures["fitted"]["commands"]["turn rate [rad/s]"]["explained"] > 0.3
    command = learnt.decide(CORRIDOR.scan(np.array([0.15, 0.2, 0.15, 0.0])), CORRIDOR.geometry, 0.15, 0.0).command
    assert command[1] < -0.1, "left of the middle and pointing left: turn right"


def test_the_same_seed_learns_the_same_again() -> None:
    settings = ImitationSettings(latent=4, hidden=8, updates=5)
    one, other = (imitate([seen(150)], OBSERVATION, settings).controller for _ in range(2))
    assert np.array_equal(one.K, other.K)
    assert np.array_equal(one.encoder.layers[0].weight, other.encoder.layers[0].weight)


def test_what_cannot_be_is_said_in_one_line(
    bags: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cartpole = tmp_path / "cartpole.safetensors"
    policy = some_policy("cartpole_swingup")
    save_policy(LatentPolicy(policy.controller, 0.08, None, policy.manifest), cartpole)
    out = ["--output", str(tmp_path / "out.safetensors")]
    for command, given, words in (
        (evaluate, [str(cartpole), str(bags[0])], "for the task cartpole_swingup, which has no lidar"),
        (evaluate, [str(cartpole), str(bags[0]), "--held-out", "1"], "which has no lidar"),
        (evaluate, ["curved_corridor_edmd", str(bags[0]), "--held-out", "1"], "--held-out is 1.0: must be"),
        (fit, ["nothing", str(bags[0]), *out], "no policy 'nothing'"),
        (fit, ["curved_corridor_edmd", str(tmp_path / "none"), *out], "none"),
        (learn_offline, [str(bags[0]), *out, "--held-out", "0.9"], "steps are too few to learn from"),
    ):
        assert command(given) == 1
        error = capsys.readouterr().err
        assert words in error
        assert "Traceback" not in error
    for command, given, words in (
        (learn_offline, [str(bags[0]), *out, "--latent", "1"], "--latent must be a whole number of at least 2"),
        (fit, ["curved_corridor_edmd", *out], "missing BAG"),
        (fit, ["curved_corridor_edmd", str(bags[0])], "missing --output"),
    ):
        with pytest.raises(SystemExit) as ended:
            command(given)
        assert ended.value.code == 2
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1
    assert not (tmp_path / "out.safetensors").exists()


def test_the_mirror_of_an_observation_is_that_of_the_mirrored_world() -> None:
    order, sign = OBSERVATION.mirror
    state = np.array([0.1, 0.3, 0.15, 0.4])
    here, there = (
        OBSERVATION.observe(CORRIDOR.scan(s), CORRIDOR.geometry, s[2], s[3]) for s in (state, state * (-1, -1, 1, -1))
    )
    assert here[order] * sign == pytest.approx(there, rel=1e-4)


def test_a_real_drive_is_predicted_better_than_by_nothing_changes(real_drive: Path, tmp_path: Path) -> None:
    """On its last fifth, which was not fitted: commands of a person, 720 beams, a lidar that faces left."""
    output = tmp_path / "real.safetensors"
    assert fit(["curved_corridor_edmd", str(real_drive), "--output", str(output)]) == 0
    held_out = load_policy(output).manifest["drives"]["held out"]
    assert held_out["steps"] == 51
    assert held_out["over_persistence"][0] < 0.97
