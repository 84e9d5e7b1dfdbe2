"""A Minari dataset of a task of the suite names its environment, and its arrays are those of that environment."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from commands import command
from ctrl_rl_learning.offline import ScriptedDriver, drive, load_transitions

from ctrl_rl_core import load_navigation_task, task_file

TASK = load_navigation_task("car_navigation")
minari = pytest.importorskip("minari")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a bag, and the dataset of it."""
    folder = tmp_path_factory.mktemp("minari")
    drive(TASK, ScriptedDriver(TASK), 4, 0, folder / "bag")
    answer = command(
        "bag", "export", folder / "bag", "--format", "minari", "--output", folder / "mine-v0", package="ctrl_rl_bags"
    )
    assert answer.returncode == 0, answer.stderr
    return folder


def test_the_environment_is_recovered_and_its_spaces_hold_the_data(folder: Path, monkeypatch) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    dataset = minari.load_dataset("mine-v0")
    environment = dataset.recover_environment()
    try:
        assert environment.spec.id == "ctrl_rl/car_navigation-v0"
        assert environment.spec.max_episode_steps == TASK.episode.steps
        assert environment.observation_space == dataset.observation_space
        assert environment.action_space == dataset.action_space
        recorded = load_transitions([folder / "bag"], TASK)
        episodes = list(dataset.iterate_episodes())
        assert len(episodes) == 4
        np.testing.assert_array_equal(
            np.concatenate([episode.observations[:-1] for episode in episodes]), recorded.observations
        )
        np.testing.assert_array_equal(np.concatenate([episode.actions for episode in episodes]), recorded.actions)
        np.testing.assert_array_equal(np.concatenate([episode.rewards for episode in episodes]), recorded.task_rewards)
        np.testing.assert_array_equal(np.concatenate([episode.terminations for episode in episodes]), recorded.done)
        assert all(dataset.observation_space.contains(row) for row in episodes[0].observations)
        seen, _ = environment.reset(seed=0)
        np.testing.assert_allclose(seen, episodes[0].observations[0], atol=2e-3)
        following, *_ = environment.step(episodes[0].actions[0])
        assert environment.observation_space.contains(following)
    finally:
        environment.close()


def test_such_a_dataset_becomes_the_same_bag_again(folder: Path) -> None:
    answer = command("bag", "import", folder / "mine-v0", "--output", folder / "again", package="ctrl_rl_bags")
    assert answer.returncode == 0, answer.stderr
    before, after = (load_transitions([bag], TASK) for bag in (folder / "bag", folder / "again" / "bag_0"))
    for field in fields(before):
        np.testing.assert_array_equal(getattr(before, field.name), getattr(after, field.name), err_msg=field.name)


def test_a_task_of_ones_own_is_named_by_its_file(folder: Path, tmp_path: Path) -> None:
    file = tmp_path / "yard.yaml"
    file.write_text(task_file("car_navigation").read_text().replace("name: car_navigation", "name: yard"))
    words = ("bag", "export", folder / "bag", "--format", "minari", "--output")
    answer = command(*words, tmp_path / "own", "--task", file, package="ctrl_rl_bags")
    assert answer.returncode == 0, answer.stderr
    environment = minari.MinariDataset(tmp_path / "own" / "data").recover_environment()
    try:
        assert environment.unwrapped.task.name == "yard"
    finally:
        environment.close()
    answer = command(*words, tmp_path / "unknown", "--task", "somewhere", package="ctrl_rl_bags")
    assert answer.returncode == 0, answer.stderr
    plain = minari.MinariDataset(tmp_path / "unknown" / "data")
    assert plain.env_spec is None
    assert set(plain.observation_space.spaces) >= {"scan", "odometry", "state"}
