"""The command `export`: afterwards a node can drive by a policy whose file did not describe its observation."""

import json
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_core.io import with_digest
from ctrl_rl_learning.cli.export import export
from test_evaluation import write

from ctrl_rl_core import Actor, PolicyError, interface_of, load_navigation_task, load_policy, task_digest, task_file


def test_a_run_becomes_a_file_that_drives(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "policy.safetensors")
    (tmp_path / "result.json").write_text(json.dumps(with_digest({"success": 0.98})))
    output = tmp_path / "drives.safetensors"
    assert export([str(tmp_path), "--output", str(output)]) == 0
    assert "car_ttr, success 98% in its environment" in capsys.readouterr().out
    actor = Actor.load(output)
    assert actor.interface == interface_of(load_navigation_task("car_ttr"))
    assert actor.manifest["metrics"] == {"success": 0.98}
    policy = load_policy(output)
    assert (policy.robot, policy.period) == ("differential_drive", 0.4)
    assert np.array(policy.limits) == pytest.approx(np.array([[-0.8, -0.5], [2.0, 0.5]]))


def test_a_task_of_one_s_own_is_given_by_its_file(tmp_path: Path) -> None:
    task = tmp_path / "mine.yaml"
    task.write_text(task_file("car_ttr").read_text().replace("name: car_ttr", "name: mine"))
    digest = {"task": "mine", "task_digest": task_digest(load_navigation_task(str(task)))}
    source, output = write(tmp_path / "policy.safetensors", digest), tmp_path / "out.safetensors"
    with pytest.raises(PolicyError, match="does not describe its observation: write it again with `ros2 run"):
        load_policy(source)
    assert export([str(source), "--task", str(task), "--output", str(output)]) == 0
    assert load_policy(output).robot == "differential_drive"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--output", "{folder}/policy.safetensors"], "policy.safetensors exists: give another name, or --overwrite"),
        (["--output", "{folder}/out.onnx"], "the name must end in .safetensors"),
        (["--output", "{folder}/out.safetensors", "--task", "quad_ttr"], "was trained on another task"),
        (["--output", "{folder}/out.safetensors", "--task", "nowhere"], "no task 'nowhere'"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    file = write(tmp_path / "policy.safetensors")
    before = file.read_bytes()
    assert export([str(file), *(word.format(folder=tmp_path) for word in words)]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert file.read_bytes() == before
    assert not list(tmp_path.glob("out*"))
