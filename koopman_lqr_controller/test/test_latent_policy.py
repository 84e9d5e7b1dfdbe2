"""Learnt policies: their computation, rejected input, and files."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_core.io import encode_tensors, read_tensors
from hypothesis import given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.models.encoder import Dense, LayerNorm
from safetensors import safe_open
from scipy.linalg import solve_discrete_are

from ctrl_rl_core import ScanGeometry
from koopman_lqr_controller import (
    Encoder,
    KoopmanError,
    KoopmanPolicy,
    LatentController,
    LatentPolicy,
    LidarObservation,
    LinearModel,
    RobotInterface,
    load_policy,
    save_policy,
)

OBSERVATION = LidarObservation(count=12)
SCAN = ScanGeometry(360, 0.0, 2 * np.pi / 360, 0.12, 3.5)


def some_controller(horizon: int | None = None, seed: int = 0, reduced: bool = False) -> LatentController:
    random = np.random.default_rng(seed)
    n, inputs = 6, len(OBSERVATION.names)
    weights = [random.normal(size=shape).astype(np.float32) for shape in ((16, inputs), (n, 16))]
    layers = (
        Dense(weights[0], np.zeros(16, np.float32), True),
        Dense(weights[1], np.ones(n, np.float32), False),
        LayerNorm(np.ones(n, np.float32), random.normal(size=n).astype(np.float32)),
    )
    encoder = Encoder(layers, (inputs,), np.float32(0.0) * np.ones(1, np.float32), np.ones(1, np.float32))
    size = 3 if reduced else n
    A = random.normal(size=(size, size))
    model = LinearModel(A * 1.05 / np.abs(np.linalg.eigvals(A)).max(), random.normal(size=(size, 2)))
    z_ref = random.normal(size=size)
    C = np.linalg.qr(random.normal(size=(n, n)))[0][:size] if reduced else None
    a_ref = None if horizon else np.array([0.4, -0.2])
    return LatentController(encoder, model, np.ones(size), np.ones(2), z_ref, horizon, C, a_ref)


def some_policy(**given: object) -> LatentPolicy:
    robot_interface = RobotInterface(OBSERVATION, np.array([0.0, -1.5]), np.array([0.22, 1.5]))
    return LatentPolicy(some_controller(**given), 0.1, robot_interface, {"task": "curved_corridor", "command": "learn"})


def some_ranges(seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.2, 3.0, 360).astype(np.float32)


def test_the_gain_is_that_of_scipys_riccati_equation() -> None:
    controller = some_controller()
    A, B = controller.model.A, controller.model.B
    P = solve_discrete_are(A, B, np.diag(controller.Q), np.diag(controller.R))
    assert pytest.approx(np.linalg.solve(np.eye(2) + B.T @ P @ B, B.T @ P @ A)) == controller.K
    assert controller.spectral_radius < 1.0
    assert controller.residual < 1e-8
    assert controller.control(controller.z_ref) == pytest.approx([0.4, -0.2])


def slopes(loop, z: np.ndarray) -> np.ndarray:
    """Return the Jacobian of a function by central differences."""
    steps = 1e-5 * np.eye(len(z))
    return np.stack([(loop(z + step) - loop(z - step)) / 2e-5 for step in steps], axis=1)


@pytest.mark.parametrize("reduced", [False, True])
def test_the_loop_as_it_is_deployed_has_the_poles_that_it_claims(reduced: bool) -> None:
    """Also for a nonzero reference control: its saturation must not change the loop there."""
    controller = some_controller(reduced=reduced)
    loop = slopes(lambda z: controller.predict(z, controller.saturate(controller.control(z))), controller.z_ref)
    assert np.abs(np.linalg.eigvals(loop)).max() == pytest.approx(controller.spectral_radius, rel=1e-6)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 1000))
def test_the_cost_to_go_falls_by_the_cost_of_a_step_along_the_model(seed: int) -> None:
    """Bellman's equation of the deviations, without saturation."""
    controller = replace(some_controller(seed=seed), a_ref=np.zeros(2))
    dz = np.random.default_rng(seed).normal(size=6)
    du = -controller.K @ dz
    step = float(dz @ (controller.Q * dz) + du @ (controller.R * du))
    z, z_next = controller.z_ref + dz, controller.z_ref + controller.model.predict(dz, du)
    assert controller.cost_to_go(z) == pytest.approx(step + controller.cost_to_go(z_next), rel=1e-6)


@pytest.mark.parametrize("horizon", [None, 5])
def test_commands_stay_within_limits_and_predictions_follow_the_model(horizon: int | None) -> None:
    policy = some_policy(horizon=horizon)
    driving: KoopmanPolicy = policy
    decision = driving.decide(some_ranges(), SCAN, 0.1, 0.3)
    assert (decision.command >= [0.0, -1.5]).all()
    assert (decision.command <= [0.22, 1.5]).all()
    action = (decision.command - policy.robot_interface.u_low) / (
        policy.robot_interface.u_high - policy.robot_interface.u_low
    ) * 2 - 1
    expected = policy.controller.predict(decision.z, action)
    assert driving.predict(decision.z, decision.command) == pytest.approx(expected)
    assert driving.cost_to_go(decision.z) >= 0.0


@pytest.mark.parametrize("given", [{}, {"horizon": 5}, {"reduced": True}])
@pytest.mark.parametrize("inclusive", [False, True])
def test_a_decision_is_what_the_controller_does_step_by_step(given: dict[str, object], inclusive: bool) -> None:
    """For all optimised paths; an inclusive encoder has none."""
    policy = some_policy(**given)
    if inclusive:
        encoder, projection = replace(policy.controller.encoder, inclusive=True), policy.controller.projection
        first = np.eye(20)[14:] if projection is None else np.pad(projection, ((0, 0), (14, 0)))
        policy = replace(policy, controller=replace(policy.controller, encoder=encoder, projection=first))
    robot_interface, controller, ranges = policy.required_interface, policy.controller, some_ranges()
    z = controller.latent(robot_interface.observation.observe(ranges, SCAN, 0.1, 0.3))
    u = controller.control(z)
    decision = policy.decide(ranges, SCAN, 0.1, 0.3)
    assert decision.z == pytest.approx(z, rel=1e-3, abs=1e-4)
    assert decision.control == pytest.approx(robot_interface.command(u), rel=1e-3, abs=1e-3)
    assert decision.command == pytest.approx(robot_interface.command(controller.saturate(u)), abs=1e-3)


@pytest.mark.parametrize("given", [{}, {"horizon": 5}, {"reduced": True}])
def test_a_file_gives_the_same_policy_back(given: dict[str, object], tmp_path: Path) -> None:
    policy, path = some_policy(**given), tmp_path / "policy.safetensors"
    save_policy(policy, path)
    again = load_policy(path)
    one, other = (p.decide(some_ranges(), SCAN, 0.1, 0.3) for p in (policy, again))
    assert np.array_equal(one.command, other.command)
    assert np.array_equal(policy.predict(one.z, one.command), again.predict(other.z, other.command))
    assert again.manifest == policy.manifest
    assert again.dt == policy.dt == 0.1
    with safe_open(path, framework="numpy") as file:
        assert not {"K", "P"} & set(file.keys()), "the gain follows from A, B, Q, R"
    assert path.stat().st_size < 1e6


def test_a_policy_of_another_task_does_not_drive(tmp_path: Path) -> None:
    policy = LatentPolicy(some_controller(), 0.08, None, {"task": "cheetah_run"})
    save_policy(policy, tmp_path / "cheetah.safetensors")
    again = load_policy(tmp_path / "cheetah.safetensors")
    with pytest.raises(KoopmanError, match="for the task cheetah_run, which has no lidar"):
        again.decide(some_ranges(), SCAN, 0.0, 0.0)
    assert np.array_equal(again.controller.action(np.ones(14)), policy.controller.action(np.ones(14)))


@pytest.mark.parametrize(("v", "omega"), [(float("nan"), 0.0), (0.0, float("inf"))])
def test_odometry_that_is_not_finite_is_refused(v: float, omega: float) -> None:
    with pytest.raises(KoopmanError, match="odometry"):
        some_policy().decide(some_ranges(), SCAN, v, omega)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"Q": np.ones(5)}, r"Q has shape \(5,\)"),
        ({"R": np.array([1.0, 0.0])}, "R must be positive"),
        ({"z_ref": np.full(6, np.nan)}, "z_ref holds values that are not finite"),
        ({"a_ref": np.array([0.0, 1.0])}, "must lie inside -1 .. 1"),
        ({"horizon": 0, "a_ref": np.zeros(2)}, "horizon is 0"),
        ({"projection": np.ones((2, 6))}, "projection has shape"),
    ],
)
def test_parts_that_do_not_fit_are_named(change: dict[str, object], words: str) -> None:
    with pytest.raises(KoopmanError, match=words):
        replace(some_controller(), **change)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("encoder.0.weight", np.nan, "not all numbers of 'encoder.0.weight' are finite"),
        ("encoder.2.bias", np.inf, "not all numbers of 'encoder.2.bias' are finite"),
        ("encoder.unit", 0.0, "unit must be positive"),
        ("encoder.unit", np.nan, "not all numbers of 'encoder.unit' are finite"),
        ("projection", np.nan, "not all numbers of 'projection' are finite"),
        ("u_high", np.inf, "not all numbers of 'u_high' are finite"),
    ],
)
def test_a_file_that_would_command_nothing_finite_is_refused(
    name: str, value: float, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "policy.safetensors"
    save_policy(some_policy(reduced=True), path)
    header, tensors, _ = read_tensors(path, "policy")
    tensors[name].flat[0] = value
    path.write_bytes(encode_tensors(tensors, "policy", header))
    with pytest.raises(KoopmanError, match=words):
        load_policy(path)


def test_an_encoder_of_another_size_is_refused() -> None:
    with pytest.raises(KoopmanError, match="do not fit each other"):
        replace(some_controller(), projection=np.ones((6, 9)))
    with pytest.raises(KoopmanError, match="must become 6 finite numbers"):
        replace(
            some_controller(), encoder=replace(some_controller().encoder, layers=some_controller().encoder.layers[:1])
        )


@pytest.mark.parametrize("dt", [0.0, -0.1, float("nan"), float("inf")])
def test_a_time_step_that_is_none_is_refused(dt: float) -> None:
    with pytest.raises(KoopmanError, match=r"dt is .* must be positive"):
        replace(some_policy(), dt=dt)


def test_a_wiring_that_does_not_fit_is_named() -> None:
    robot_interface = RobotInterface(LidarObservation(count=36), np.zeros(2), np.ones(2))
    with pytest.raises(KoopmanError, match=r"the robot gives \(38,\)"):
        LatentPolicy(some_controller(), 0.1, robot_interface)
    with pytest.raises(KoopmanError, match="u_low below u_high"):
        RobotInterface(OBSERVATION, np.zeros(2), np.zeros(2))


def test_a_file_that_lacks_something_gives_one_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    save_policy(some_policy(), path)
    header, tensors, _ = read_tensors(path, "policy")
    others = {name: tensor for name, tensor in tensors.items() if name != "z_ref"}
    path.write_bytes(encode_tensors(others, "policy", header))
    with pytest.raises(KoopmanError, match=r"policy\.safetensors: lacks the tensor 'z_ref': train it again"):
        load_policy(path)
    path.write_bytes(encode_tensors(tensors, "policy", header | {"encoder": {"layers": [{"kind": "x"}]}}))
    with pytest.raises(KoopmanError, match=r"policy\.safetensors: encoder"):
        load_policy(path)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 1000), st.integers(200, 800))
def test_the_observation_hardly_depends_on_the_count_of_beams(seed: int, beams: int) -> None:
    """A wall on all sides whose distance varies slowly with bearing, measured by lidars of different kinds."""
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi)

    def seen(count: int) -> np.ndarray:
        bearings = 2 * np.pi / count * np.arange(count)
        ranges = (1.0 + 0.3 * np.sin(bearings + phase)).astype(np.float32)
        return OBSERVATION.observe(ranges, ScanGeometry(count, 0.0, 2 * np.pi / count, 0.0, 100.0), 0.1, 0.2)

    assert seen(beams) == pytest.approx(seen(360), abs=0.02)


def test_an_observation_that_cannot_be_is_refused() -> None:
    with pytest.raises(KoopmanError, match="closest < far"):
        LidarObservation(closest=4.0)


def test_deciding_needs_neither_torch_nor_a_simulator(tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    save_policy(some_policy(), path)
    program = (
        "import sys\nfrom pathlib import Path\nimport numpy as np\n"
        "import koopman_lqr_controller.nodes.controller_node as node\n"
        f"policy = node.load_policy(Path({str(path)!r}))\n"
        "policy.decide(np.ones(360, np.float32), node._SOME_SCAN, 0.0, 0.0)\n"
        "sys.exit(any(name in sys.modules for name in ('torch', 'gymnasium', 'pybullet', 'mujoco')))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
