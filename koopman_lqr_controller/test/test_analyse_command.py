"""`analyse` from a policy file to a page: all parts with an environment, and a line for each part without one."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from koopman_lqr_controller.cli.analyse import analyse
from koopman_lqr_controller.models.encoder import Dense
from koopman_lqr_controller.training.analysis.page import page
from koopman_lqr_controller.training.analysis.policy_world import make_world
from koopman_lqr_controller.training.analysis.true_system import corridor_system
from koopman_lqr_controller.training.environments.control_suite import ControlSuite

from koopman_lqr_controller import (
    Encoder,
    LatentController,
    LatentPolicy,
    LinearModel,
    find_policy,
    load_policy,
    save_policy,
)

PICTURES = ("closed_loop", "controllability", "costs", "observations", "poles", "prediction", "tsne")
PARTS = {"policy", "poles", "true_poles", "controllability", "costs", "data", "prediction", "latents", "observations"}
PARTS |= {"tsne", "closed_loop"}


def cartpole(horizon: int | None = 3, task: str = "cartpole_swingup") -> LatentPolicy:
    """Return a policy whose latent is the observation itself."""
    one = np.ones(1, np.float32)
    encoder = Encoder((Dense(np.eye(5, dtype=np.float32), 0 * one, False),), (5,), 0 * one, one)
    model = LinearModel(0.9 * np.eye(5), np.full((5, 1), 0.1))
    Q = np.array([5.0, 1.0, 1.0, 1.0, 0.0])
    controller = LatentController(encoder, model, Q, np.ones(1), np.array([0.0, 1.0, 0.0, 0.0, 0.0]), horizon)
    return LatentPolicy(controller, 0.08, None, {"task": task})


def run(file: Path, folder: Path, *more: str) -> tuple[dict, str]:
    assert analyse([str(file), "--output", str(folder), "--episodes", "1", *more]) == 0
    found = json.loads((folder / "analysis.json").read_text(encoding="utf-8"))
    return found, (folder / "analysis.md").read_text(encoding="utf-8")


def test_a_policy_with_a_world_is_analysed_whole(tmp_path: Path) -> None:
    save_policy(cartpole(), tmp_path / "policy.safetensors")
    found, text = run(tmp_path / "policy.safetensors", tmp_path / "page")
    assert found["left_out"] == {}
    assert set(found) >= PARTS
    assert [pole[0] for pole in found["true_poles"]["open"]] == pytest.approx([1.367, 1.0, 1.0, 0.732], abs=2e-3)
    assert found["observations"]["names"][0] == "position 0"
    spread = np.array(found["observations"]["spread"])
    assert found["observations"]["cost"] == pytest.approx(np.array(found["costs"]["Q"]) * spread**2, rel=1e-3, abs=1e-6)
    pictures = sorted(file.name for file in (tmp_path / "page").iterdir() if file.suffix in (".png", ".svg"))
    assert [name[:-4] for name in pictures] == sorted(PICTURES)
    assert all(f"]({name})" in text for name in pictures)
    assert page(found, "policy.safetensors", {}).count("](") == 0


def test_without_a_world_what_the_file_says_is_left(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_policy(cartpole(None, "somewhere"), tmp_path / "policy.safetensors")
    found, text = run(tmp_path / "policy.safetensors", tmp_path / "page")
    assert set(found["left_out"]) == PARTS - {"policy", "poles", "controllability", "costs"}
    assert "no task 'somewhere'" in found["left_out"]["true_poles"]
    assert "## Left out" in text
    assert "not as learnt" in text, "whose Q it is"
    assert "left out   tsne: no task 'somewhere'" in capsys.readouterr().out


def test_a_policy_of_another_corridor_is_judged_without_it(tmp_path: Path) -> None:
    shipped = load_policy(find_policy("curved_corridor_edmd"))
    make_world(shipped).close()
    other = replace(shipped, manifest={**shipped.manifest, "task_digest": "of yesterday"})
    save_policy(other, tmp_path / "policy.safetensors")
    found, _ = run(tmp_path / "policy.safetensors", tmp_path / "page")
    assert "has changed since the policy was made" in found["left_out"]["prediction"]
    assert found["poles"]


def test_a_policy_that_is_none_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = ["--output", str(tmp_path / "page")]
    assert analyse(["none", *page]) == 1
    error = capsys.readouterr().err
    assert "no policy 'none'" in error
    assert error.count("\n") == 1
    with pytest.raises(SystemExit) as ended:
        analyse(["curved_corridor_edmd", "--episodes", "0", *page])
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert "--episodes must be a whole number of at least 1" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "page").exists()


def test_a_simulated_system_is_placed_where_it_is_told() -> None:
    environment = ControlSuite("cartpole", "swingup", 8)
    again = environment.place(np.array([0.3, 0.1, -0.2, 0.4]))
    assert environment.state == pytest.approx([0.3, 0.1, -0.2, 0.4])
    assert again == pytest.approx([0.3, np.cos(0.1), np.sin(0.1), -0.2, 0.4], rel=1e-5)
    assert environment.names == ("position 0", "position 1", "position 2", "velocity 0", "velocity 1")


def test_the_shipped_policy_comes_to_rest_in_the_middle_of_a_corridor() -> None:
    policy = load_policy(find_policy("curved_corridor_edmd"))
    found = corridor_system(policy, 0.7, 0.2, 0.18)
    assert found.closed_poles is not None
    assert np.abs(found.closed_poles).max() < 1.0
    assert found.rest[:2] == pytest.approx([0.0, 0.0], abs=1e-3)
    loop = policy.closed_loop_model()
    weights = policy.manifest["weights"]
    wanted = policy.observables.state_cost(weights["side"], weights["ahead"], weights["speed"])
    assert pytest.approx(wanted, abs=1e-8) == loop.Q
    assert pytest.approx([weights["acceleration"], weights["turning"]]) == loop.R
