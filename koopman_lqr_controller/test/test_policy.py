"""Observables, policies and their files."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from ctrl_rl_core import Interval, ScanGeometry
from koopman_lqr_controller import (
    DEFAULT_POLICY,
    CorridorObservables,
    EdmdPolicy,
    KoopmanError,
    Snapshots,
    find_policy,
    load_policy,
    save_policy,
    shipped_policies,
    train,
)

OBSERVABLES = CorridorObservables()
LIMITS = (Interval(-0.22, 0.22), Interval(-2.84, 2.84))


def some_policy() -> EdmdPolicy:
    random = np.random.default_rng(0)
    n = len(OBSERVABLES.names)
    z, u = random.normal(size=(600, n)), random.normal(size=(600, 2))
    B = np.zeros((n, 2))
    B[-2, 1] = B[-1, 0] = 0.9
    B[: n - 2, 1] = -0.1
    z_next = 0.9 * z + u @ B.T
    return train([Snapshots(z, u, z_next)], OBSERVABLES, speed=0.18, limits=LIMITS)


@pytest.fixture(scope="module")
def policy() -> EdmdPolicy:
    return some_policy()


def between_walls(width: float, offset: float, heading: float, beams: int = 360) -> np.ndarray:
    """Ranges of a lidar between two infinite straight walls; offset [m] to the left, heading [rad] to the left."""
    bearing = np.arange(beams) * 2 * np.pi / beams + heading
    with np.errstate(divide="ignore", over="ignore"):
        ahead = np.where(np.sin(bearing) > 0, (width / 2 - offset), (width / 2 + offset)) / np.abs(np.sin(bearing))
    return np.minimum(ahead, 3.5).astype(np.float32)


def scan_of(ranges: np.ndarray) -> ScanGeometry:
    return ScanGeometry(len(ranges), 0.0, 2 * np.pi / len(ranges), 0.12, 3.5)


def lift(ranges: np.ndarray, v: float = 0.18, omega: float = 0.0) -> np.ndarray:
    return OBSERVABLES.observe(ranges, scan_of(ranges), v, omega)


def test_the_middle_of_a_straight_corridor_is_the_reference(policy: EdmdPolicy) -> None:
    assert lift(between_walls(0.7, 0.0, 0.0)) == pytest.approx(policy.z_ref, abs=1e-6)


@settings(deadline=None)
@given(st.floats(-0.2, 0.2), st.floats(-0.5, 0.5), st.floats(-1, 1))
def test_swapping_left_and_right_changes_the_signs_that_mirror_says(
    offset: float, heading: float, omega: float
) -> None:
    one = lift(between_walls(0.7, offset, heading), omega=omega)
    other = lift(between_walls(0.7, -offset, -heading), omega=-omega)
    assert other == pytest.approx(OBSERVABLES.mirror * one, abs=1e-5)


def test_nearer_to_the_left_wall_is_positive_and_grows() -> None:
    index = OBSERVABLES.bearings_deg.index(90.0)
    values = [lift(between_walls(0.7, offset, 0.0))[index] for offset in (0.0, 0.05, 0.1, 0.15)]
    assert values == sorted(values)
    assert values[1] > 0.05


def test_commands_stay_within_limits_and_predictions_follow_the_model(policy: EdmdPolicy) -> None:
    ranges = between_walls(0.7, 0.15, 0.6)
    decision = policy.decide(ranges, scan_of(ranges), v=0.1, omega=2.0)
    assert (decision.command >= policy.u_low).all()
    assert (decision.command <= policy.u_high).all()
    assert decision.command == pytest.approx(np.clip(decision.control, policy.u_low, policy.u_high))
    expected = (
        policy.z_ref + policy.model.A @ (decision.z - policy.z_ref) + policy.model.B @ (decision.command - policy.u_ref)
    )
    assert policy.predict(decision.z, decision.command) == pytest.approx(expected)
    assert policy.cost_to_go(decision.z) >= 0.0


@pytest.mark.parametrize(("v", "omega"), [(float("nan"), 0.0), (0.0, float("inf"))])
def test_odometry_that_is_not_finite_is_refused(policy: EdmdPolicy, v: float, omega: float) -> None:
    ranges = between_walls(0.7, 0.0, 0.0)
    with pytest.raises(KoopmanError, match="odometry"):
        policy.decide(ranges, scan_of(ranges), v, omega)


def test_a_file_gives_the_same_policy_back(policy: EdmdPolicy, tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    save_policy(policy, path)
    again = load_policy(path)
    ranges = between_walls(0.65, 0.1, 0.2)
    one, other = (p.decide(ranges, scan_of(ranges), 0.1, 0.3) for p in (policy, again))
    assert (one.command == other.command).all()
    assert again.manifest == json.loads(json.dumps(policy.manifest))
    assert [file.name for file in tmp_path.iterdir()] == ["policy.safetensors"]
    with pytest.raises(KoopmanError, match="exists"):
        save_policy(policy, path)
    save_policy(policy, path, overwrite=True)


def test_a_broken_file_gives_one_clear_error(policy: EdmdPolicy, tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    save_policy(policy, path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(KoopmanError, match="is not a whole safetensors file"):
        load_policy(path)
    path.write_bytes(whole)
    tensors = load_file(path)
    save_file(tensors, path)
    with pytest.raises(KoopmanError, match="is a safetensors file of another kind"):
        load_policy(path)
    for header in ([], "x", {"format": []}, {"format": "koopman-latent-2", "controller": 3}):
        save_file(tensors, path, {"policy": json.dumps(header)})
        with pytest.raises(KoopmanError, match=r"policy\.safetensors: "):
            load_policy(path)
    header = json.dumps({"A": {"dtype": "BF16", "shape": [1], "data_offsets": [0, 2]}}).encode()
    path.write_bytes(len(header).to_bytes(8, "little") + header + b"\0\0")
    with pytest.raises(KoopmanError, match="tensor 'A' is of type 'BF16', which is not read"):
        load_policy(path)
    with pytest.raises(KoopmanError, match="no policy 'missing'"):
        find_policy("missing")
    with pytest.raises(KoopmanError, match="name too long"):
        find_policy(300 * "long")


def test_a_policy_with_a_wrong_shape_or_nan_is_refused(policy: EdmdPolicy) -> None:
    given = {name: getattr(policy, name) for name in ("observables", "model", "P", "z_ref", "u_ref", "u_low", "u_high")}
    with pytest.raises(KoopmanError, match="K has shape"):
        EdmdPolicy(**given, K=policy.K[:, 1:])
    with pytest.raises(KoopmanError, match="K holds values"):
        EdmdPolicy(**given, K=np.full_like(policy.K, np.nan))
    for dt in (0, -0.2, "0.2", float("nan")):
        with pytest.raises(KoopmanError, match=f"dt is {dt}: must be a positive time"):
            EdmdPolicy(**given, K=policy.K, manifest={"dt": dt})
    assert EdmdPolicy(**given, K=policy.K, manifest={"dt": 0.2}).dt == 0.2


@pytest.mark.parametrize("name", shipped_policies())
def test_a_shipped_policy_is_small_whole_and_stable(name: str) -> None:
    path = shipped_policies()[name]
    shipped = load_policy(path)
    assert path.stat().st_size < 1_000_000
    assert shipped.manifest["spectral_radius"] < 1.0
    assert shipped.manifest["dare_residual"] < 1e-8
    assert shipped.manifest["error_over_persistence"] < 1.0


@pytest.mark.parametrize("name", shipped_policies())
def test_a_shipped_policy_drives_on_and_steers_to_the_middle(name: str) -> None:
    shipped = load_policy(shipped_policies()[name])

    def command(offset: float) -> NDArray[np.float64]:
        ranges = between_walls(0.7, offset, 0.0)
        return shipped.decide(ranges, scan_of(ranges), 0.18, 0.0).command

    middle, left, right = command(0.0), command(0.1), command(-0.1)
    assert middle[0] > 0.15
    assert left[1] < middle[1] - 0.05
    assert right[1] > middle[1] + 0.05


def test_the_classical_policy_drives_straight_in_the_middle() -> None:
    shipped = load_policy(find_policy("curved_corridor_edmd"))
    ranges = between_walls(0.7, 0.0, 0.0)
    middle = shipped.decide(ranges, scan_of(ranges), shipped.manifest["speed"], 0.0)
    assert middle.command == pytest.approx([shipped.manifest["speed"], 0.0], abs=1e-3)


def test_what_is_driven_with_by_default_comes_with_the_command_that_makes_it() -> None:
    assert load_policy(find_policy(DEFAULT_POLICY)).manifest["command"].startswith("ros2 run koopman_lqr_controller")
