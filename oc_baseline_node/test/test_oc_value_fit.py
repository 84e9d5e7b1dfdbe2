"""V_oc as a network: fit, NumPy against torch, gradients, files, figures."""

import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import torch
from ctrl_rl_core.values import Axis
from oc_baseline_node.values.collision_set import CollisionHeader, CollisionSet
from oc_baseline_node.values.mlp_value import features
from oc_baseline_node.values.value_file import load_network

from ctrl_rl_core import CtrlRlError, ValueFunction, ValueFunctionError, ValueGrid, load_navigation_task, task_digest
from oc_baseline_node import (
    DataSettings,
    FitSettings,
    MlpValue,
    OcError,
    OptimalControlProblem,
    ValueData,
    draw_heat_map,
    draw_trajectories,
    find_value,
    fit,
    formulate,
    load_value,
    make_data,
    save_value,
)

Made = tuple[OptimalControlProblem, ValueData, MlpValue]
STATE = np.array([-3.0, -3.5, 0.7])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    problem = formulate(load_navigation_task("car_navigation"))
    data, *_ = make_data(problem, DataSettings(40), tmp_path_factory.mktemp("data"), progress=False)
    return problem, data, fit(problem, data, FitSettings(epochs=60), progress=False)


def random_states(value: MlpValue, count: int) -> np.ndarray:
    low = np.array([axis.lower for axis in value.axes])
    high = np.array([axis.upper for axis in value.axes])
    return low + (high - low) * np.random.default_rng(0).random((count, len(low)))


def test_the_fit_explains_trajectories_it_has_not_seen(made: Made) -> None:
    problem, _, value = made
    unseen = value.manifest["held_out"]
    assert unseen["rmse"] < 0.6 * unseen["std_of_values"]  # of four trajectories, from 36
    assert value.manifest["data"]["trajectories"] == 40
    assert 40 < value.manifest["data"]["states"] < 40 * 140  # up to each arrival
    assert value.task_digest == problem.digest
    near, far = value.value([(3.0, 3.0, 0.0), (-4.0, -4.0, 0.0)])
    assert near > far + 15


def test_the_same_seed_gives_the_same_network(made: Made) -> None:
    problem, data, value = made
    again = fit(problem, data, FitSettings(epochs=60), progress=False)
    assert again.digest == value.digest
    assert fit(problem, data, FitSettings(epochs=1, seed=1), progress=False).digest != value.digest


def test_the_error_is_of_many_trajectories_that_the_network_fitted_without(made: Made) -> None:
    """Four of forty would be too few: each of five networks is tested on a different four."""
    unseen = made[2].manifest["held_out"]
    assert unseen["trajectories"] == 20
    assert unseen["mae_low"] < unseen["mae"] < unseen["mae_high"]
    assert unseen["mae"] > made[2].manifest["fitted"]["mae"]


def test_too_few_trajectories_are_refused(made: Made) -> None:
    problem, data, _ = made
    one = ValueData(data.states[:1], data.controls[:1], data.time_steps[:1], data.cpu_seconds[:1], data.unsolved,
                    data.reasons, data.doomed, data.wasted_seconds)  # fmt: skip
    with pytest.raises(OcError, match="too few"):
        fit(problem, one, progress=False)


def test_numpy_and_torch_give_the_same_values_and_gradients(made: Made) -> None:
    value = made[2].without_collisions()
    states = random_states(value, 500)
    layers: list[torch.nn.Module] = []
    for weight, bias in value.layers:
        linear = torch.nn.Linear(weight.shape[1], weight.shape[0], dtype=torch.float64)
        linear.weight.data, linear.bias.data = torch.tensor(weight), torch.tensor(bias)
        layers += [linear, torch.nn.Tanh()]
    inputs = torch.tensor(features(value.axes, states), requires_grad=True)
    theirs = value.offset + value.scale * torch.nn.Sequential(*layers[:-1])(inputs)[:, 0]
    ours, gradient = value.value_and_gradient(states)
    assert ours == pytest.approx(theirs.detach().numpy(), rel=1e-12)
    slope = torch.autograd.grad(theirs.sum(), inputs)[0].numpy()
    assert gradient[:, 0] == pytest.approx(slope[:, 0] / 5.0, rel=1e-9, abs=1e-9)


def test_gradients_are_those_of_finite_differences(made: Made) -> None:
    value = made[2].without_collisions()
    states = random_states(value, 200) * 0.99
    _, gradient = value.value_and_gradient(states)
    step = 1e-5
    for index in range(3):
        offset = step * np.eye(3)[index]
        difference = (value.value(states + offset) - value.value(states - offset)) / (2 * step)
        assert gradient[:, index] == pytest.approx(difference, rel=1e-4, abs=1e-3)


def test_it_is_a_value_function_like_any_other(made: Made) -> None:
    value: ValueFunction = made[2]
    assert (value.kind, value.task, value.state_names) == ("oc_value", "car_navigation", ("x", "y", "theta"))
    one, gradient = value.value_and_gradient_at(STATE)
    assert one == value.value(STATE) == value.value(STATE[None, None])[0, 0]
    assert gradient == pytest.approx(value.value_and_gradient(STATE)[1])
    turned = STATE + np.array((0.0, 0.0, 2 * np.pi))
    assert value.value(turned) == pytest.approx(one), "an angle wraps"


def test_outside_the_arena_it_says_nothing(made: Made) -> None:
    value = made[2]
    values, gradients = value.value_and_gradient([(5.2, 0.0, 0.0), (np.nan, 0.0, 0.0), STATE])
    assert np.isnan(values).tolist() == [True, True, False]
    assert np.isnan(gradients).all(axis=1).tolist() == [True, True, False]
    assert value.clipped((5.2, 0.0, 7.0)) == pytest.approx([5.0, 0.0, 7.0])
    with pytest.raises(OcError, match=r"give \(\.\.\., 3\): x, y, theta"):
        value.value([1.0, 2.0])


def test_in_collision_it_is_what_the_task_pays(made: Made) -> None:
    value = made[2]
    values, gradients = value.value_and_gradient([(0.0, 0.0, 1.0), (4.9, 0.0, 0.0), (0.5, 0.0, 0.0)])
    assert values.tolist() == [-400.0] * 3
    assert not gradients.any()
    assert value.without_collisions().value((0.0, 0.0, 1.0)) > 500
    quad = load_navigation_task("quad_navigation")
    paid = CollisionSet.of(quad)
    states = np.zeros((2, 6))
    states[:, 2], states[:, 4] = 3.0, (1.5, 0.0)
    names = quad.system.build().state_names
    assert paid.rewards(names, states).tolist()[0] == -800.0
    assert np.isnan(paid.rewards(names, states)[1])
    assert CollisionSet.from_file(CollisionHeader.model_validate(paid.as_json())) == paid


def test_the_grid_holds_its_values_at_the_nodes(made: Made) -> None:
    value = made[2]
    (grid,) = value.grids
    assert grid.kind == "oc_value"
    assert (grid.task, grid.task_digest) == (value.task, value.task_digest)
    assert grid.residual == value.manifest["held_out"]["rmse"]
    index = (10, 20, 5)
    state = [axis.nodes[i] for axis, i in zip(grid.axes, index, strict=True)]
    assert grid.values[index] == pytest.approx(value.value(state), rel=1e-6)
    assert grid.value((-4.0, 3.0, 1.0)) == pytest.approx(value.value((-4.0, 3.0, 1.0)), abs=0.5)


def test_a_grid_of_six_components_takes_little_more_memory_than_itself() -> None:
    axes = tuple(Axis(name, "1", -1.0, 1.0, 9) for name in "abcdef")
    layers = ((np.eye(4, 6), np.zeros(4)), (np.ones((1, 4)), np.zeros(1)))
    value = MlpValue(layers, axes, 0.0, 1.0, "t", "0" * 64)
    tracemalloc.start()
    (grid,) = value.grids
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2.5 * grid.values.nbytes + 10e6
    random = np.random.default_rng(0)
    for index in map(tuple, random.integers(0, 9, (20, 6))):
        state = [axis.nodes[i] for axis, i in zip(axes, index, strict=True)]
        assert grid.values[index] == pytest.approx(value.value(state), rel=1e-6)


def test_a_file_gives_back_what_was_saved(made: Made, tmp_path: Path) -> None:
    value, path = made[2], tmp_path / "v.safetensors"
    save_value(value, path)
    again = load_network(path)
    assert again.digest == value.digest
    assert again.manifest == value.manifest
    states = random_states(value, 300)
    assert again.value(states) == pytest.approx(value.value(states), abs=1e-3)
    with pytest.raises(OcError, match="exists: give another name"):
        save_value(value, path)
    value.grids[0].save(tmp_path / "g.safetensors")
    assert isinstance(load_value(tmp_path / "g.safetensors"), ValueGrid)
    with pytest.raises(OcError, match="holds a value grid"):
        load_network(tmp_path / "g.safetensors")


@pytest.mark.parametrize("content", [None, b"", b"nonsense", b"\x08\x00\x00\x00\x00\x00\x00\x00{}      "])
def test_a_wrong_file_is_refused_by_name(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "wrong.safetensors"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(CtrlRlError, match=r"wrong\.safetensors"):
        load_value(path)


@pytest.mark.parametrize("name", ["car_navigation", "curved_corridor", "quad_navigation", "quad_trap"])
def test_the_shipped_networks_belong_to_the_tasks_as_they_are(name: str) -> None:
    value, task = load_network(find_value(name)), load_navigation_task(name)
    assert value.task_digest == task_digest(task), "the task has changed: make the value again"
    assert value.manifest["data"]["trajectories"] == task.optimal_control.trajectories
    assert value.manifest["discount"] == task.optimal_control.discount
    unseen = value.manifest["held_out"]
    assert unseen["rmse"] < 0.25 * unseen["std_of_values"]
    with pytest.raises(OcError, match="no value 'nothing'"):
        find_value("nothing")


def test_layers_that_do_not_fit_are_refused() -> None:
    axes = (Axis("x", "m", 0.0, 1.0, 2),)
    good = ((np.ones((4, 1)), np.zeros(4)), (np.ones((1, 4)), np.zeros(1)))
    assert MlpValue(good, axes, 0.0, 1.0, "t", "0" * 64).value([0.5]) == 0.0
    for layers, words in (
        ((good[0],), "has 4 outputs; it must have 1"),
        ((good[1], good[1]), "layer 0 has shapes"),
        (((np.full((4, 1), np.nan), np.zeros(4)), good[1]), "not finite"),
    ):
        with pytest.raises(OcError, match=words):
            MlpValue(layers, axes, 0.0, 1.0, "t", "0" * 64)


def test_pictures_are_drawn(made: Made, tmp_path: Path) -> None:
    problem, data, value = made
    values = draw_heat_map(value, problem.task, tmp_path / "map.png", {"theta": 0.5}, cells=60)
    assert values.shape == (60, 60)
    assert values[30, 30] == -400.0, "a cube stands in the middle"
    assert values[50, 50] > values[5, 5]
    draw_trajectories(problem.task, list(data.states[:2]), tmp_path / "path.png")
    for name in ("map.png", "path.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueFunctionError, match="'phi' cannot be fixed"):
        draw_heat_map(value, problem.task, tmp_path / "other.png", {"phi": 0.5})
    with pytest.raises(OcError, match="are not those of task"):
        draw_heat_map(value, load_navigation_task("quad_trap"), tmp_path / "other.png")


def test_what_serves_values_imports_nothing_heavy() -> None:
    code = "import sys, oc_baseline_node.node, oc_baseline_node.value_data.dataset; print(*sys.modules)"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=os.environ, check=False)
    assert answer.returncode == 0, answer.stderr
    loaded = {name.partition(".")[0] for name in answer.stdout.split()}
    assert not loaded & {"torch", "casadi", "gymnasium", "pybullet", "matplotlib", "stable_baselines3"}
