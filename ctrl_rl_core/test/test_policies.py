"""Interfaces of policies, their observations and files, and policy kinds of other packages."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from ctrl_rl_core.policies.observation import ObservationBuilder
from ctrl_rl_core.policies.policy import policy_digest, shipped_policies
from ctrl_rl_core.sensing.scan import ScanGeometry
from hypothesis import given, settings
from hypothesis import strategies as st
from policy_files import DRIVE, FLY, actor, manifest, write
from pydantic import ValidationError

from ctrl_rl_core import Actor, PolicyError, PolicyManifest, Sensors, find_policy, load_policy, make_odometry

TURN = 2.0 * math.pi
LIDAR = ScanGeometry(360, 0.0, TURN / 360, 0.12, 3.5)


def sensors(ranges=None, scan=LIDAR, pose=None, goal=None, command=(0.0, 0.0)) -> Sensors:
    ranges = np.ones(scan.beams, np.float32) if ranges is None else np.asarray(ranges, np.float32)
    odometry = make_odometry(np.zeros(3), np.array((0.3, 0.0, -0.5)))
    return Sensors(ranges, scan, odometry, pose, goal, np.array(command))


def observe(*parts: dict, **given) -> np.ndarray:
    return ObservationBuilder(manifest(observation=list(parts)))(sensors(**given))


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_network_that_has_diverged_is_not_written(tmp_path: Path, value: float) -> None:
    sound = actor(manifest())
    broken = replace(sound, biases=(np.full_like(sound.biases[0], value), *sound.biases[1:]))
    with pytest.raises(PolicyError, match="has diverged"):
        broken.save(tmp_path / "policy.safetensors")
    assert not list(tmp_path.iterdir())


def test_parts_follow_each_other_cut_off_and_scaled() -> None:
    found = observe(
        {"source": "odometry", "names": ["omega", "v"], "low": -0.4, "unit": [0.2, 0.1]},
        {"source": "command", "names": ["v"], "middle": 1.0},
        {"source": "scan", "count": 2, "step": math.pi, "low": 0.1, "high": 0.8, "middle": 0.5, "unit": 0.1},
        command=(0.2, 0.0),
    )
    assert found == pytest.approx([-2.0, 3.0, -0.8, 3.0, 3.0])
    assert found.dtype == np.float32


def test_a_goal_is_seen_from_the_pose() -> None:
    names = ["distance", "bearing", "ahead", "left", "turn", "x", "cos_bearing", "sin_bearing"]
    pose, goal = np.array((1.0, 2.0, 0.5 * math.pi)), np.array((-1.0, 2.0, math.pi))
    found = observe({"source": "goal", "names": names}, pose=pose, goal=goal)
    assert found == pytest.approx([2.0, 0.5 * math.pi, 0.0, 2.0, 0.5 * math.pi, -1.0, 0.0, 1.0], abs=1e-6)


@pytest.mark.parametrize(
    ("part", "given", "message"),
    [
        ({"source": "goal", "names": ["distance"]}, {}, "no goal yet"),
        ({"source": "goal", "names": ["distance"]}, {"goal": np.zeros(3)}, "no pose yet"),
        ({"source": "pose", "names": ["x"]}, {}, "no pose yet"),
        ({"source": "pose", "names": ["x"]}, {"pose": np.full(3, np.nan)}, "not finite"),
        (
            {"source": "scan", "count": 3, "step": 1.0, "high": 3.0},
            {"scan": ScanGeometry(60, -0.5, 1.0 / 60, 0.1, 3.0)},
            "the lidar does not look to 57 deg",
        ),
    ],
)
def test_what_is_missing_is_said(part: dict, given: dict, message: str) -> None:
    with pytest.raises(PolicyError, match=message):
        observe(part, **given)


def test_beams_without_a_range_read_what_they_mean() -> None:
    ranges = np.ones(4)
    scan = ScanGeometry(4, 0.0, 0.25 * TURN, 0.12, 3.5)
    part = {"source": "scan", "count": 4, "step": 0.25 * TURN, "low": 0.1, "high": 3.0}
    for value, wanted in ((np.inf, 3.0), (-np.inf, 0.12), (np.nan, 1.0), (0.0, 3.0), (0.05, 1.0), (9.0, 3.0)):
        ranges[1] = value
        assert observe(part, ranges=ranges, scan=scan) == pytest.approx([1.0, wanted, 1.0, 1.0])


def test_bearings_need_not_be_evenly_spaced() -> None:
    ranges = 1.0 + np.arange(360) / 1000.0
    part = {"source": "scan", "count": 3, "at": [-0.5 * math.pi, 0.0, 1.0], "high": 10.0}
    assert observe(part, ranges=ranges) == pytest.approx([1.27, 1.0, 1.057])


@settings(max_examples=60, deadline=None)
@given(
    beams=st.integers(36, 800),
    first=st.floats(-7.0, 7.0),
    forwards=st.booleans(),
    half_width=st.sampled_from([0.0, 0.1, 0.4]),
    reduce=st.sampled_from(["least", "median"]),
)
def test_the_same_bearings_are_seen_by_any_lidar(
    beams: int, first: float, forwards: bool, half_width: float, reduce: str
) -> None:
    """The range is a smooth function of the bearing, so all lidars give almost the same result."""
    scan = ScanGeometry(beams, first, (TURN if forwards else -TURN) / beams, 0.1, 10.0)
    bearings = first + scan.angle_increment * np.arange(beams)
    part = {"source": "scan", "count": 9, "first": -2.0, "step": 0.5, "high": 10.0}
    found = observe({**part, "half_width": half_width, "reduce": reduce}, ranges=3.0 + np.sin(bearings), scan=scan)
    assert found == pytest.approx(3.0 + np.sin(-2.0 + 0.5 * np.arange(9)), abs=half_width + 2.0 * TURN / beams)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"robot": "boat"}, "robot"),
        ({"observation": []}, "at least 1"),
        ({"observation": [{"source": "odometry", "names": ["z"]}]}, "odometry has no 'z': it has x, y"),
        ({"observation": [{"source": "odometry", "names": ["v"], "low": [1.0, 2.0]}]}, "low has 2 numbers"),
        ({"observation": [{"source": "odometry", "names": ["v"], "low": 2.0, "high": 1.0}]}, "low must not lie above"),
        ({"observation": [{"source": "odometry", "names": ["v"], "unit": 0.0}]}, "unit must be above 0"),
        ({"observation": [{"source": "odometry", "names": ["v"], "high": math.nan}]}, "finite"),
        ({"observation": [{"source": "scan", "count": 10**9, "high": 1.0}]}, "less than or equal to 1000"),
        ({"observation": [{"source": "scan", "count": 2, "at": [0.1], "high": 1.0}]}, "at has 1 bearings: must be 2"),
        ({"largest_distance": -1.0}, "greater than 0"),
        ({"action": {"low": [0.0, 1.0], "high": [1.0, 1.0]}}, "the minimum must lie below the maximum"),
        ({"action": {**DRIVE["action"], "choices": [[0.0, 0.0], [0.0, 5.0]]}}, "is not between low and high"),
        ({"rest": [1.0, 0.0]}, "stands at 0 m/s"),
        ({"period": 0.0}, "greater than 0"),
        ({**FLY, "rest": [0.0, 0.0]}, "needs its hover thrusts"),
        ({**FLY, "observation": [{"source": "pose", "names": ["x"]}]}, "a planar_quadrotor has no pose"),
        ({"speed": 1.0}, "Extra inputs"),
    ],
)
def test_an_interface_that_makes_no_sense_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        manifest(**changes)


def test_outputs_become_commands() -> None:
    action = manifest(action={**DRIVE["action"], "span": [0.0, 2.0]}).action
    assert action.command(np.array((1.0, 5.0))) == pytest.approx([0.1, 1.0])
    squashed = manifest(action={**DRIVE["action"], "squash": "tanh"}).action
    assert squashed.command(np.array((0.0, 0.5))) == pytest.approx([0.1, math.tanh(0.5)])
    choices = manifest(action={**DRIVE["action"], "choices": [[0.1, 1.0], [0.2, 0.0], [0.1, -1.0]]}).action
    assert choices.command(np.array((0.3, 0.9, -4.0))) == pytest.approx([0.2, 0.0])
    assert np.isnan(choices.command(np.array((np.nan, 0.9, -4.0)))).all()


def test_a_file_gives_back_what_was_written(tmp_path: Path) -> None:
    file = write(tmp_path, action=(0.5, -0.5), period=0.4, about="straight on")
    assert Actor.load(file).interface == manifest(period=0.4, about="straight on")
    policy = load_policy(find_policy(str(file)))
    assert (policy.robot, policy.period, policy.needs) == ("differential_drive", 0.4, frozenset())
    assert policy.command(sensors()) == pytest.approx([0.15, -0.5])


def test_a_network_that_does_not_fit_its_interface_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "policy.safetensors"
    replace(actor(manifest()), interface=PolicyManifest.model_validate(FLY)).save(file)
    with pytest.raises(PolicyError, match=r"network takes 6 numbers and gives 2, its interface has 10"):
        load_policy(file)


def test_what_is_no_policy_is_said_in_one_line(tmp_path: Path) -> None:
    there = "actor, onnx, policy"
    (tmp_path / "other.safetensors").write_bytes(b"\x02\x00\x00\x00\x00\x00\x00\x00{}")
    (tmp_path / "text.txt").write_text("drive")
    for name, message in (
        ("", r"no policy is given \(parameter policy\): there are .*curved_corridor.*, or give a file"),
        ("nobody", "no policy 'nobody': there are"),
        (f"{tmp_path}/none.safetensors", "there is no such file"),
        (f"{tmp_path}/other.safetensors", f"holds no policy that a node can drive by: there are readers for {there}"),
        (f"{tmp_path}/text.txt", "is not a whole safetensors file"),
        (f"{tmp_path}/none.onnx", "there is no such file"),
    ):
        with pytest.raises(PolicyError, match=message) as caught:
            load_policy(find_policy(name))
        assert "\n" not in str(caught.value)


@pytest.mark.fault
def test_a_broken_file_is_refused_in_one_line_whatever_is_broken(tmp_path: Path) -> None:
    whole = write(tmp_path).read_bytes()
    random, file = np.random.default_rng(5), tmp_path / "broken.safetensors"
    refused = []
    for _ in range(150):
        content = bytearray(whole)
        if random.random() < 0.3:
            content = content[: random.integers(len(content))]
        else:
            for place in random.integers(len(content), size=random.integers(1, 4)):
                content[place] = random.integers(256)
        file.write_bytes(content)
        try:
            load_policy(file)
        except PolicyError as error:
            refused.append(str(error))
    assert len(refused) > 140
    assert all(said.startswith(f"{file}: ") and said.isprintable() for said in refused)


def test_shipped_policies_are_whole() -> None:
    shipped = shipped_policies()
    assert {"curved_corridor", "curved_corridor_edmd"} <= set(shipped)
    for file in shipped.values():
        assert load_policy(file).description, "it was tried in a plain situation, too"


def onnx_file(folder: Path, size: int = 6, outputs: int = 2, bias: float = 0.5, inputs: int = 1) -> Path:
    """Write a model with constant outputs, and its manifest."""
    onnx = pytest.importorskip("onnx")
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    given = [helper.make_tensor_value_info(f"observation_{i}", kind, ["batch", size]) for i in range(inputs)]
    made = [helper.make_tensor_value_info("action", kind, ["batch", outputs])]
    constants = [
        helper.make_tensor("W", kind, (size, outputs), np.zeros(size * outputs)),
        helper.make_tensor("b", kind, (outputs,), np.full(outputs, bias)),
    ]
    node = helper.make_node("Gemm", ["observation_0", "W", "b"], ["action"])
    graph = helper.make_graph([node], "policy", given, made, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    file = folder / "policy.onnx"
    file.write_bytes(model.SerializeToString())
    file.with_suffix(".yaml").write_text(yaml.safe_dump(DRIVE))
    return file


def test_an_onnx_model_drives_by_its_manifest(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    file = onnx_file(tmp_path)
    assert load_policy(find_policy(str(file))).command(sensors()) == pytest.approx([0.15, 0.5])
    for changes, message in (
        ({"size": 5}, "the model fails"),
        ({"outputs": 3}, "the model gives 3 numbers of type float32, its manifest wants 2"),
        ({"bias": math.nan}, r"its command in front of a wall at 1 m is \[nan, nan\]"),
        ({"inputs": 2}, "has the inputs observation_0: .*: one of type"),
    ):
        with pytest.raises(PolicyError, match=message):
            load_policy(onnx_file(tmp_path, **changes))
    file = onnx_file(tmp_path)
    file.with_suffix(".yaml").write_text(yaml.safe_dump({**DRIVE, "largest_distance": 1.3}))
    with pytest.raises(PolicyError, match="the model gives no distance as its second output"):
        load_policy(file)
    file.write_bytes(b"no model")
    with pytest.raises(PolicyError, match=r"policy\.onnx: is no ONNX model"):
        load_policy(file)


def test_an_onnx_model_without_manifest_or_runtime_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "policy.onnx"
    file.write_bytes(b"model")
    with pytest.raises(PolicyError, match=r"policy\.yaml: there is no such file: an ONNX policy needs its manifest"):
        load_policy(file)
    file.with_suffix(".yaml").write_text(yaml.safe_dump({**DRIVE, "robot": "boat"}))
    with pytest.raises(PolicyError, match=r"policy\.yaml: robot: "):
        load_policy(file)
    file.with_suffix(".yaml").write_text(yaml.safe_dump(DRIVE))
    monkeypatch.setitem(__import__("sys").modules, "onnxruntime", None)
    with pytest.raises(PolicyError, match=r"'onnxruntime', which is not installed: python -m pip install -r"):
        load_policy(file)


def hostile_model(kind: str) -> bytes:
    """Return an ONNX model that exceeds the time or memory limit, or crashes."""
    onnx = pytest.importorskip("onnx")
    helper, number = onnx.helper, onnx.TensorProto
    given = helper.make_tensor_value_info("observation", number.FLOAT, ["batch", 6])
    made = helper.make_tensor_value_info("action", number.FLOAT, ["batch", 2])
    weights = helper.make_tensor("W", number.FLOAT, (6, 2), np.zeros(12))
    nodes = [helper.make_node("MatMul", ["observation", "W"], ["action"])]
    more = [weights]
    if kind == "endless":
        body = helper.make_graph(
            [
                helper.make_node("Identity", ["going"], ["going_on"]),
                helper.make_node("Sin", ["state"], ["next_state"]),
            ],
            "body",
            [
                helper.make_tensor_value_info("turn", number.INT64, []),
                helper.make_tensor_value_info("going", number.BOOL, []),
                helper.make_tensor_value_info("state", number.FLOAT, ["batch", 6]),
            ],
            [
                helper.make_tensor_value_info("going_on", number.BOOL, []),
                helper.make_tensor_value_info("next_state", number.FLOAT, ["batch", 6]),
            ],
        )
        more += [
            helper.make_tensor("turns", number.INT64, [], [2**62]),
            helper.make_tensor("yes", number.BOOL, [], [1]),
        ]
        nodes = [
            helper.make_node("Loop", ["turns", "yes", "observation"], ["end"], body=body),
            helper.make_node("MatMul", ["end", "W"], ["action"]),
        ]
    if kind == "large":
        more.append(helper.make_tensor("shape", number.INT64, [2], [2**20, 6]))
        more.append(helper.make_tensor("V", number.FLOAT, [6, 2**13], np.zeros(6 * 2**13)))
        nodes = [
            helper.make_node("ConstantOfShape", ["shape"], ["many"]),
            helper.make_node("MatMul", ["many", "V"], ["giant"]),
            helper.make_node("ReduceMax", ["giant"], ["largest"], keepdims=0),
            helper.make_node("MatMul", ["observation", "W"], ["plain"]),
            helper.make_node("Add", ["plain", "largest"], ["action"]),
        ]
    if kind == "elsewhere":
        weights.ClearField("float_data")
        weights.data_location = number.EXTERNAL
        weights.external_data.add(key="location", value="weights.bin")
    graph = helper.make_graph(nodes, "policy", [given], [made], more)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    return bytes(model.SerializeToString())


@pytest.mark.fault
@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("endless", "takes more than 2 s"),
        ("large", "takes more than|the model fails"),
        ("elsewhere", "stores its weights in another file"),
    ],
)
def test_a_hostile_onnx_model_is_refused_in_bounded_time_and_memory(
    kind: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("onnxruntime")
    monkeypatch.setattr("ctrl_rl_core.policies.onnx_policy.TIME", 2.0 if kind == "endless" else 20.0)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "weights.bin").write_bytes(bytes(48))
    file = tmp_path / "policy.onnx"
    file.write_bytes(hostile_model(kind))
    file.with_suffix(".yaml").write_text(yaml.safe_dump(DRIVE))
    with pytest.raises(PolicyError, match=message):
        load_policy(file)


def test_the_digest_of_an_onnx_policy_covers_its_manifest(tmp_path: Path) -> None:
    file = tmp_path / "policy.onnx"
    file.write_bytes(b"model")
    file.with_suffix(".yaml").write_text(yaml.safe_dump(DRIVE))
    before = policy_digest(file)
    file.with_suffix(".yaml").write_text(yaml.safe_dump({**DRIVE, "action": {"low": [0.0, -1.0], "high": [0.9, 1.0]}}))
    assert policy_digest(file) != before
