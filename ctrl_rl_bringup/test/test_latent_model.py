"""What a bag tells about the model that drove, on bags written for it."""

import json
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_bringup.corridor.latent_model import LatentModel, read_latent_model
from ctrl_rl_core.ros import to_stamp
from rclpy.serialization import serialize_message

from ctrl_rl_bags import BagWriter, Topic, message_definition
from ctrl_rl_msgs.msg import LatentState
from koopman_lqr_controller import digest, find_policy, load_policy

KIND = "ctrl_rl_msgs/msg/LatentState"
POLICY = find_policy("curved_corridor_edmd")


def recorded(bag: Path, latents: list[LatentState], policy_digest: str = "", policy: str = str(POLICY)) -> LatentModel:
    """Write a bag, read it, and return what it says."""
    with BagWriter(bag) as writer:
        writer.add_topic(Topic("/koopman_lqr_controller/latent", KIND, message_definition(KIND)))
        for index, latent in enumerate(latents):
            latent.header.stamp = to_stamp(index * 10**9)
            writer.write("/koopman_lqr_controller/latent", serialize_message(latent), log_time=index + 1)
        writer.set_custom_data("parameters./koopman_lqr_controller", json.dumps({"policy": policy}))
        writer.set_custom_data("digest.policy", policy_digest or digest(POLICY))
    found = read_latent_model(bag)
    assert found is not None
    return found


def walk() -> list[LatentState]:
    """Return latents that move by (3, 4), one predicted half right; then a stop, and a scan that showed nothing."""
    z = [[0.0, 0.0], [3.0, 4.0], [6.0, 8.0]]
    return [
        LatentState(z=z[0], prediction_error=float("nan"), distance=0.2),
        LatentState(z=z[1], z_predicted=z[0], prediction_error=5.0, distance=0.7),
        LatentState(z=z[2], z_predicted=z[2], prediction_error=0.0, distance=1.5, stop="outside"),
        LatentState(
            z=[float("nan")] * 2, prediction_error=float("nan"), distance=float("nan"), stop="no recent odometry"
        ),
        LatentState(z=z[0], prediction_error=float("nan"), distance=0.1),
    ]


def test_the_error_stands_beside_that_of_nothing_changes(tmp_path: Path) -> None:
    model = recorded(tmp_path / "bag", walk())
    assert model.steps.tolist() == [[1.0, 5.0, 5.0], [2.0, 0.0, 5.0]]
    assert model.error_over_persistence == pytest.approx(np.sqrt(0.5))
    assert model.dimensions == 2
    assert model.farthest == 1.5
    assert model.stops == {"outside": 1, "no recent odometry": 1}
    assert any("0.71 of that of 'nothing changes', 2 steps" in line for line in model.text())


def test_the_poles_are_those_of_the_policy_that_drove(tmp_path: Path) -> None:
    model = recorded(tmp_path / "bag", walk())
    expected = np.linalg.eigvals(load_policy(POLICY).loop)
    assert np.sort(np.abs(model.poles)) == pytest.approx(np.sort(np.abs(expected)))
    assert model.spectral_radius == pytest.approx(load_policy(POLICY).manifest["spectral_radius"])
    assert f"spectral radius {model.spectral_radius:.3f}" in model.text()[0]
    json.dumps(model.as_dict(), allow_nan=False)


@pytest.mark.parametrize("given", [{"policy_digest": "0" * 64}, {"policy": "gone.safetensors"}])
def test_poles_of_another_policy_are_not_claimed(given: dict[str, str], tmp_path: Path) -> None:
    model = recorded(tmp_path / "bag", walk(), **given)
    assert len(model.poles) == 0
    assert "poles unknown" in model.text()[0]
    assert json.loads(json.dumps(model.as_dict(), allow_nan=False))["spectral_radius"] is None


def test_a_bag_without_a_koopman_controller_has_no_model(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(Topic("/said", "std_msgs/msg/String", message_definition("std_msgs/msg/String")))
    assert read_latent_model(tmp_path / "bag") is None
