"""Any environment with continuous actions can be learnt; what cannot is refused in one line."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.environments.benchmark_tasks import find_task
from koopman_lqr_controller.training.environments.environment_tasks import name_environment
from koopman_lqr_controller.training.environments.own_environment import OwnEnvironment, make_gymnasium
from koopman_lqr_controller.training.environments.task import title_of

MINE = '''
import gymnasium
import numpy as np
from gymnasium import spaces


class Cart(gymnasium.Env):
    """A cart that should stand at 0, pushed by up to 2 N; it never ends by itself."""

    def __init__(self):
        self.observation_space = spaces.Dict(
            {"place": spaces.Box(-10.0, 10.0, (1,)), "speed": spaces.Box(-10.0, 10.0, (1,))}
        )
        self.action_space = spaces.Box(-2.0, 2.0, (1,))
        self.dt = 0.1

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.np_random.uniform(-1.0, 1.0, 2)
        return self._look(), {}

    def step(self, action):
        assert np.all(np.abs(action) <= 2.0)
        self.x = np.clip(self.x + 0.1 * np.array([self.x[1], float(action[0])]), -10.0, 10.0)
        return self._look(), float(1.0 - min(1.0, abs(self.x[0]))), False, False, {}

    def _look(self):
        place, speed = self.x.astype(np.float32)
        return {"place": np.array([place]), "speed": np.array([speed])}


def short():
    return gymnasium.wrappers.TimeLimit(Cart(), 50)


def number():
    return 3
'''


class Shows(gymnasium.Env[Any, Any]):
    """Shows a picture whose left half is white after the first step."""

    observation_space = spaces.Box(0, 255, (144, 216, 3), np.uint8)
    action_space = spaces.Box(-1.0, 1.0, (2,))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed, options=options)
        return np.zeros((144, 216, 3), np.uint8), {}

    def step(self, _action: Any) -> Any:
        picture = np.zeros((144, 216, 3), np.uint8)
        picture[:, :108] = 255
        return picture, 1.0, False, False, {}


class Broken(gymnasium.Env[Any, Any]):
    """Returns what it is told to, whatever it is."""

    observation_space: Any = spaces.Box(-1.0, 1.0, (2,))
    action_space: Any = spaces.Box(-1.0, 1.0, (1,))

    def __init__(self, seen: float = 0.0, reward: float = 0.0) -> None:
        self.seen, self.reward = seen, reward

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed, options=options)
        return np.zeros(2, np.float32), {}

    def step(self, _action: Any) -> Any:
        return np.array([0.0, self.seen], np.float32), self.reward, False, False, {}


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    file = tmp_path / "mine.py"
    file.write_text(MINE)
    (tmp_path / "wrong.py").write_text("import numpy\nx = nunpy.zeros(2)\n")
    return file


def test_a_class_of_a_file_is_adapted(mine: Path) -> None:
    task = find_task(name_environment(f"{mine}:Cart", 3))
    assert task.repeat == 3
    environment = task.make(True)
    check_env(environment, skip_render_check=True)
    assert environment.dt == pytest.approx(0.3)
    assert environment.names == ("place 0", "speed 0")
    environment.reset(seed=1)
    _, reward, *_ = environment.step(np.ones(1, np.float32))
    assert 0.0 < reward <= 3.0


def test_an_environment_that_never_ends_is_truncated_and_a_limit_is_kept(mine: Path) -> None:
    for name, steps in (("Cart", 1000), ("short", 50)):
        environment = find_task(name_environment(f"{mine}:{name}", 1)).make(True)
        environment.reset(seed=0)
        ends = [environment.step(np.zeros(1))[2:4] for _ in range(steps)]
        assert ends[-1] == (False, True)
        assert not any(any(end) for end in ends[:-1])


def test_pictures_are_grey_small_and_stacked() -> None:
    environment = OwnEnvironment("shows", Shows(), 1)
    first, _ = environment.reset(seed=0)
    assert environment.pictures
    assert first.shape == environment.observation_space.shape
    second = environment.step(np.zeros(2))[0]
    assert second[:2].max() == 0
    assert second[2, :, :36].min() == 255
    assert second[2, :, 36:].max() == 0


def test_actions_span_the_environments_own_bounds() -> None:
    environment = OwnEnvironment("Pendulum-v1", make_gymnasium("Pendulum-v1"), 2)
    environment.reset(seed=0)
    low = environment.step(np.array([-1.0]))
    inner = make_gymnasium("Pendulum-v1")
    inner.reset(seed=0)
    rewards = [inner.step(np.array([-2.0], np.float32))[1] for _ in range(2)]
    assert low[1] == pytest.approx(sum(map(float, rewards)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("NoSuch-v0", "environment NoSuch-v0"),
        ("no_such_package:Mine-v0", "environment no_such_package"),
        ("CartPole-v1", "continuous"),
        ("walker_wolk", "did you mean walker_walk"),
        ("{folder}/none.py:Cart", "is no Python file"),
        ("{folder}/mine.py:Wagon", "has no Wagon"),
        ("{folder}/wrong.py:Cart", "wrong.py: NameError"),
        ("{folder}/mine.py:number", "makes an object of type int"),
    ],
)
def test_what_cannot_be_learnt_is_refused_in_one_line(mine: Path, text: str, message: str) -> None:
    with pytest.raises(KoopmanError, match=message) as caught:
        find_task(name_environment(text.format(folder=mine.parent)))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "space", [spaces.Box(-np.inf, np.inf, (1,)), spaces.Box(0.0, 0.0, (1,)), spaces.Box(-1.0, 1.0, (0,))]
)
def test_actions_without_finite_bounds_are_refused(space: spaces.Box) -> None:
    broken = Broken()
    broken.action_space = space
    with pytest.raises(KoopmanError, match="finite bounds"):
        OwnEnvironment("broken", broken, 1)


def test_what_is_not_finite_is_named() -> None:
    for seen, reward, message in ((np.nan, 0.0, r"not finite \(x 1\)"), (0.0, np.inf, "reward of inf")):
        environment = OwnEnvironment("broken", Broken(seen, reward), 1)
        environment.reset(seed=0)
        with pytest.raises(KoopmanError, match=message):
            environment.step(np.zeros(1))


def test_names_are_fit_for_files(mine: Path) -> None:
    assert title_of(name_environment(f"{mine}:Cart")) == "mine.py_Cart@1"
    assert title_of(name_environment("my_package:Mine-v0")) == "my_package_Mine-v0@1"
    assert title_of(name_environment("walker_walk")) == "walker_walk@2"
    assert title_of("some/folder/hall.yaml") == "hall"
