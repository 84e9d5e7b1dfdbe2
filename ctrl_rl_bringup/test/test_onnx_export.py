"""Policies leave as ONNX models with cards, by the command `export`."""

from dataclasses import replace
from pathlib import Path
from shutil import copy

import numpy as np
import pytest
from ctrl_rl_bringup.cards.success import Share, Success, read_success
from ctrl_rl_bringup.cards.zoo import all_shipped, describe, zoo_pages
from ctrl_rl_bringup.cli.export import export
from ctrl_rl_bringup.transfer import play_episode
from ctrl_rl_core.io import read_experiment
from ctrl_rl_core.networks import Dense, Network, Prepend, to_onnx
from ctrl_rl_core.policies import TOLERANCE, largest_difference, shipped_policies

from ctrl_rl_core import (
    Actor,
    CtrlRlError,
    PolicyError,
    ScanGeometry,
    Sensors,
    find_policy,
    load_navigation_task,
    load_policy,
    make_odometry,
    write_results,
)
from koopman_lqr_controller import Encoder, LatentController, LatentPolicy, LinearModel, save_policy
from sim_bridge import SimulationOptions

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "results"
LIDAR = ScanGeometry(360, 0.0, 2.0 * np.pi / 360, 0.12, 3.5)


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """Runs the command in an empty folder and returns its exit code, and what it said on both streams."""
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    monkeypatch.chdir(tmp_path)

    def call(*words):
        try:
            code = export([*map(str, words)])
        except SystemExit as end:
            code = end.code
        return code, *capsys.readouterr()

    return call


@pytest.mark.parametrize("name", all_shipped())
def test_a_shipped_policy_leaves_and_its_model_agrees(name, run, tmp_path):
    words = (name, "--onnx", "--output", "out", "--results", "onnx.json", "--transfer", RESULTS / "transfer.json")
    code, said, errors = run(*words)
    assert (code, errors) == (0, "")
    (row,) = read_experiment(tmp_path / "onnx.json").rows
    assert (row.method, row.metric) == (name, "largest difference")
    assert 0.0 < row.mean <= TOLERANCE
    card = (tmp_path / "out" / f"{name}.md").read_text(encoding="utf-8")
    assert f"differs by at most {row.mean:.1e}" in card
    assert "Not measured" not in card
    assert "Apache-2.0" in card
    if name in shipped_policies():
        assert load_policy(tmp_path / "out" / f"{name}.onnx").robot == load_policy(find_policy(name)).robot
        assert f"policy:=out/{name}.onnx" in said
    else:
        assert not (tmp_path / "out" / f"{name}.yaml").exists()
        assert "no node drives by it" in said


def test_a_model_stops_the_robot_where_its_policy_does(run, tmp_path):
    assert run("curved_corridor_edmd", "--onnx")[0] == 0
    both = load_policy(find_policy("curved_corridor_edmd")), load_policy(tmp_path / "curved_corridor_edmd.onnx")
    odometry = make_odometry(np.zeros(3), np.array((0.1, 0.0, 0.0)))
    known = Sensors(np.full(360, 0.4, np.float32), LIDAR, odometry, None, None, np.zeros(2))
    assert both[1].command(known) == pytest.approx(both[0].command(known), abs=1e-6)
    spinning = make_odometry(np.zeros(3), np.array((0.1, 0.0, 50.0)))
    strange = Sensors(
        np.tile(np.repeat((0.13, 3.4), 10), 18).astype(np.float32), LIDAR, spinning, None, None, np.zeros(2)
    )
    for policy in both:
        with pytest.raises(CtrlRlError, match="has left the region seen in training"):
            policy.command(strange)


@pytest.mark.parametrize("name", ["car_ttr", "curved_corridor"])
def test_a_model_drives_as_its_policy(name, run, tmp_path):
    assert run(name, "--onnx")[0] == 0
    task, options = load_navigation_task(name), SimulationOptions(engine="mujoco")
    own, exported = (
        play_episode(load_policy(file), task, 0, options) for file in (find_policy(name), tmp_path / f"{name}.onnx")
    )
    assert own.outcome == exported.outcome == "GOAL"


@pytest.mark.fault
def test_a_model_that_differs_is_refused(run, tmp_path, monkeypatch):
    description = describe(find_policy("car_ttr"))
    layers = list(description.network.heads["action"])
    index = max(place for place, layer in enumerate(layers) if isinstance(layer, Dense))
    layers[index] = replace(layers[index], bias=layers[index].bias + 1e-3)
    other = description.network._replace(heads={"action": tuple(layers)})
    assert largest_difference(description, to_onnx(other, "other", {}), count=200) > TOLERANCE
    monkeypatch.setattr("ctrl_rl_bringup.cli.export.describe", lambda _file: description._replace(network=other))
    code, _, errors = run("car_ttr", "--onnx")
    assert code == 1
    assert errors.startswith("export: car_ttr: its ONNX model differs by ")
    assert not list(tmp_path.iterdir())


def test_a_policy_of_ones_own_says_what_was_measured(run, tmp_path):
    file = tmp_path / "runs" / "mine" / "policy.safetensors"
    file.parent.mkdir(parents=True)
    copy(find_policy("car_ttr"), file)
    actor = Actor.load(file)
    replace(actor, unit=2.0 * actor.unit).save(file)
    assert run(file)[0] == 0
    card = (tmp_path / "mine.md").read_text(encoding="utf-8")
    assert "Not measured: run" in card
    assert "transfer --policies mine=policy.safetensors --task car_ttr" in card
    assert "not stated" in card
    assert run(file, "--overwrite", "--transfer", RESULTS / "transfer.json")[0] == 0, "those are of another file"
    assert "Not measured: run" in (tmp_path / "mine.md").read_text(encoding="utf-8")


def test_figures_count_for_the_very_file_only(tmp_path):
    found = read_success(RESULTS / "transfer.json", find_policy("car_ttr"), "car_ttr")
    rows = {row.method: row for row in read_experiment(RESULTS / "transfer.json").rows if row.metric == "success"}
    assert found.shares["mujoco", "nominal"] == Share(int(sum(rows["car_ttr, mujoco, nominal"].values)), 20)
    assert read_success(RESULTS / "transfer.json", find_policy("car_navigation"), "car_ttr") is None
    write_results(tmp_path / "empty.json", "transfer", [0], [])
    assert read_success(tmp_path / "empty.json", find_policy("car_ttr"), "car_ttr") is None


def test_limits_are_conditions_whose_interval_lies_below():
    shares = {("mujoco", "nominal"): Share(20, 20), ("mujoco", "late"): Share(17, 20), ("mujoco", "ice"): Share(9, 20)}
    assert Success(shares, "").limits() == ["ice: 9 of 20 (26 to 66 %) in MuJoCo"]


def test_a_policy_of_a_task_without_a_lidar_is_exported_for_other_runtimes(run, tmp_path):
    file = without_lidar(tmp_path / "pole.safetensors")
    code, said, _ = run(file, "--onnx")
    assert code == 0
    assert "no node drives by it" in said
    assert not (tmp_path / "pole.yaml").exists()


def without_lidar(file, **layer):
    """Write a Koopman policy of three numbers, with one layer."""
    generator = np.random.default_rng(0)
    weights = {"encoder.0.weight": generator.normal(size=(2, 3)), "encoder.0.bias": np.zeros(2)}
    layers = [layer or {"kind": "dense", "rectified": False}]
    tensors = {"encoder.middle": np.zeros(1), "encoder.unit": np.ones(1), **({} if layer else weights)}
    shape = [1, 2, 2] if layer else [3]
    encoder = Encoder.build({"shape": shape, "layers": layers, "inclusive": not layer}, tensors)
    n = 4 if layer else 5
    model = LinearModel(0.9 * np.eye(n), generator.normal(size=(n, 1)))
    controller = LatentController(encoder, model, Q=np.ones(n), R=np.ones(1), z_ref=np.zeros(n), horizon=5)
    save_policy(LatentPolicy(controller, 0.1, manifest={"task": "pole"}), file)
    return file


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nobody", "--onnx"), "no policy 'nobody': there are"),
        (("none.safetensors", "--onnx"), "none.safetensors: there is no such file"),
        (("car_ttr", "--output", "file/out"), "file is a file: name a folder"),
        (("car_ttr", "--results", "onnx.json"), "give --onnx too"),
        (("car_ttr", "--transfer", "none.json"), "--transfer none.json: there is no such file"),
        (("car_ttr", "car_ttr"), "two policies are called car_ttr"),
        (("pictures.safetensors", "--onnx"), "observes pictures of shape (1, 2, 2): only vectors can be exported"),
        (("broken.onnx", "--onnx", "--output", "out"), "does not describe its network"),
        (("broken.safetensors", "--onnx", "--output", "out"), "is not a whole safetensors file"),
        (("car_ttr", "--transfer", "broken.onnx"), "broken.onnx"),
        (("kept.safetensors",), "kept.md exists: give another folder, or --overwrite"),
    ],
)
def test_what_cannot_be_exported_is_refused_in_one_line(words, message, run, tmp_path):
    (tmp_path / "file").touch()
    without_lidar(tmp_path / "pictures.safetensors", kind="flatten")
    copy(find_policy("car_ttr"), tmp_path / "kept.safetensors")
    for name in ("broken.onnx", "broken.safetensors", "kept.md"):
        (tmp_path / name).write_text("text")
    there = sorted(tmp_path.rglob("*"))
    code, _, errors = run(*words)
    assert code in (1, 2)
    (line,) = errors.splitlines()
    assert line.startswith("export: ")
    assert message in line
    assert sorted(tmp_path.rglob("*")) == there


def test_a_layer_without_operators_is_refused():
    pytest.importorskip("onnx")
    network = Network(3, (Prepend((object(),)),), {"action": ()})
    with pytest.raises(CtrlRlError, match="has a layer without ONNX operators: object"):
        to_onnx(network, "strange", {})


def test_without_the_package_the_command_says_what_to_install(run, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "onnx", None)
    code, _, errors = run("car_ttr", "--onnx")
    assert code == 1
    assert errors == (
        "export: needs the package 'onnx', which is not installed: python -m pip install -r requirements/onnx.txt\n"
    )


def test_the_zoo_has_a_card_of_each_shipped_policy():
    pages = zoo_pages(RESULTS)
    assert set(pages) == {"policies.md", *(f"policy_{name}.md" for name in all_shipped())}
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for name in pages:
        assert f": reference/{name}\n" in nav
        assert f"({name})" in pages["policies.md"] or name == "policies.md"
    assert "Not measured" not in "".join(pages.values())
    assert pages["policies.md"].count("e-0") == len(all_shipped()), (
        "the difference of each is in docs/results/onnx.json"
    )


def test_an_old_policy_that_describes_nothing_cannot_be_exported(tmp_path):
    file = tmp_path / "old.safetensors"
    actor = Actor.load(find_policy("car_ttr"))
    replace(actor, interface=None, manifest={}).save(file)
    with pytest.raises(PolicyError, match="does not describe its observation"):
        describe(file)
