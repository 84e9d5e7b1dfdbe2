"""Any Gymnasium environment with continuous actions, as the learner sees it: one vector, or grey pictures.

The observation is flattened, or three grey pictures of 72 x 72 pixels; the action is [-1, 1] for each actuator, held
for a number of steps.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.environments.control_suite import FRAMES

SIZE = 72
"""Rows and columns of a picture."""
_STEPS = 1000
"""Length of an episode of an environment that never ends by itself [its steps]."""
_GREY = np.array((0.299, 0.587, 0.114))
_LARGEST = 100_000
"""Maximum number of components of an observation."""

Observation = NDArray[Any]


class OwnEnvironment(gymnasium.Env[Observation, NDArray[np.float32]]):
    """A user's environment with the interface of the learner.

    Observation: all components (n,) float32; or the last `FRAMES` grey pictures (FRAMES, SIZE, SIZE) uint8 of an
    environment that shows one. Action: [-1, 1] for each actuator. Reward: the sum over the repeated steps. An
    environment without a time limit is truncated after 1000 of its own steps.

    Args:
        name: Name in messages.
        inner: Environment to adapt.
        repeat: Number of its steps per action.

    Attributes:
        pictures: Whether the observation is a picture.
        names: Name of each component of a vector observation.
        dt: Hold time of an action [s]; if the environment does not state its time step, in steps.

    Raises:
        KoopmanError: Actions are not continuous with finite bounds, or the observation cannot be a vector or picture.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - gymnasium's own form

    def __init__(self, name: str, inner: gymnasium.Env[Any, Any], repeat: int) -> None:
        self._name, self._repeat = name, repeat
        self._inner = inner if _has_limit(inner) else gymnasium.wrappers.TimeLimit(inner, _STEPS)
        self._low, self._high = _action_bounds(name, inner.action_space)
        self.action_space = spaces.Box(-1.0, 1.0, (self._low.size,), np.float32)
        self.pictures = _is_picture(inner.observation_space)
        self.names: tuple[str, ...] = ()
        self.dt = repeat * _time_step(inner)
        self._shown: list[NDArray[np.uint8]] = []
        if self.pictures:
            self.observation_space: spaces.Box = spaces.Box(0, 255, (FRAMES, SIZE, SIZE), np.uint8)
            return
        self.names = tuple(_component_names(name, inner.observation_space))
        if not 0 < len(self.names) <= _LARGEST:
            raise KoopmanError(f"{name}: an observation has {len(self.names)} components: must be 1 to {_LARGEST}")
        self.observation_space = spaces.Box(-np.inf, np.inf, (len(self.names),), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode."""
        super().reset(seed=seed)
        observation, info = self._inner.reset(seed=seed, options=options)
        self._shown = []
        return self._observe(observation), dict(info)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold an action (m,).

        Raises:
            KoopmanError: The environment returns a reward or an observation that is not finite.
        """
        share = 0.5 * (np.clip(np.asarray(action, dtype=float), -1.0, 1.0) + 1.0)
        space = self._inner.action_space
        control = (self._low + share * (self._high - self._low)).reshape(space.shape or ()).astype(space.dtype)
        total, terminated, truncated = 0.0, False, False
        observation: Any = None
        info: dict[str, Any] = {}
        for _ in range(self._repeat):
            observation, reward, terminated, truncated, info = self._inner.step(control)
            total += float(reward)
            if terminated or truncated:
                break
        if not math.isfinite(total):
            raise KoopmanError(f"{self._name}: returned a reward of {total}: must be finite")
        return self._observe(observation), total, bool(terminated), bool(truncated and not terminated), dict(info)

    def close(self) -> None:
        """Close the environment."""
        self._inner.close()

    def _observe(self, observation: Any) -> Observation:
        if self.pictures:
            picture = _grey(np.asarray(observation))
            self._shown = [*self._shown, picture][-FRAMES:] if self._shown else [picture] * FRAMES
            return np.stack(self._shown)
        flat = np.asarray(spaces.flatten(self._inner.observation_space, observation), dtype=np.float32)
        if not np.isfinite(flat).all():
            wrong = self.names[int(np.argmin(np.isfinite(flat)))]
            raise KoopmanError(f"{self._name}: returned an observation that is not finite ({wrong})")
        return flat


def make_gymnasium(name: str) -> gymnasium.Env[Any, Any]:
    """Make an environment that is registered with Gymnasium.

    Args:
        name: Its identifier, such as "Pendulum-v1", or "my_package:Mine-v0" to import a package first.

    Raises:
        KoopmanError: There is no such environment, or it needs something that is not installed.
    """
    try:
        return gymnasium.make(name)
    except (gymnasium.error.Error, ImportError) as error:
        raise KoopmanError(f"environment {name}: {' '.join(str(error).split())}") from None


def make_from_file(place: str) -> gymnasium.Env[Any, Any]:
    """Make an environment by a class or function without arguments in a Python file.

    Args:
        place: FILE.py:NAME.

    Raises:
        KoopmanError: The file or the name does not exist, or makes no environment.
    """
    path, _, name = place.rpartition(":")
    make: Callable[[], Any] | None = getattr(_load_module(Path(path)), name, None)
    if make is None:
        raise KoopmanError(f"{path} has no {name}: give FILE.py:NAME of a class or function that makes an environment")
    made = make()
    if not isinstance(made, gymnasium.Env):
        raise KoopmanError(f"{place} makes an object of type {type(made).__name__}: must be a gymnasium.Env")
    return made


def _load_module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise KoopmanError(f"{path}: is no Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise KoopmanError(f"{path}: {type(error).__name__}: {' '.join(str(error).split())}") from error
    return module


def _has_limit(environment: gymnasium.Env[Any, Any]) -> bool:
    """Return whether some wrapper truncates episodes."""
    inner = environment
    while isinstance(inner, gymnasium.Wrapper):
        if isinstance(inner, gymnasium.wrappers.TimeLimit):
            return True
        inner = inner.env
    return False


def _action_bounds(name: str, space: gymnasium.Space[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    if not isinstance(space, spaces.Box):
        raise KoopmanError(f"{name}: its actions are {space}: a linear law needs continuous ones (Box)")
    low, high = space.low.astype(float).ravel(), space.high.astype(float).ravel()
    if not low.size or not np.isfinite([low, high]).all() or not (low < high).all():
        raise KoopmanError(f"{name}: its actions are {space}: each needs finite bounds, low below high")
    return low, high


def _is_picture(space: gymnasium.Space[Any]) -> bool:
    if not isinstance(space, spaces.Box) or space.dtype != np.uint8:
        return False
    return len(space.shape) == 2 or (len(space.shape) == 3 and space.shape[-1] in (1, 3, 4))


def _time_step(environment: gymnasium.Env[Any, Any]) -> float:
    """Return the environment's time step [s]; 1 if it states none."""
    rate = environment.unwrapped.metadata.get("render_fps") or 0.0
    for value in (getattr(environment.unwrapped, "dt", None), 1.0 / rate if rate else None):
        if isinstance(value, (int, float)) and 0.0 < value < math.inf:
            return float(value)
    return 1.0


def _component_names(name: str, space: gymnasium.Space[Any], before: str = "") -> list[str]:
    """Return a name for each component of the flattened observation, in its order."""
    if isinstance(space, spaces.Dict):
        return [each for key, part in space.spaces.items() for each in _component_names(name, part, f"{before}{key} ")]
    if isinstance(space, spaces.Tuple):
        parts = enumerate(space.spaces)
        return [each for key, part in parts for each in _component_names(name, part, f"{before}{key} ")]
    try:
        return [f"{before or 'x '}{index}" for index in range(spaces.flatdim(space))]
    except (NotImplementedError, ValueError):
        raise KoopmanError(f"{name}: observations of {space} have no fixed number of components") from None


def _grey(picture: NDArray[Any]) -> NDArray[np.uint8]:
    """Return a picture (rows, columns[, channels]) in grey (SIZE, SIZE), averaged over areas."""
    from PIL import Image  # only for pictures

    flat = (
        picture[..., :3] @ _GREY if picture.ndim == 3 and picture.shape[-1] >= 3 else picture.reshape(picture.shape[:2])
    )
    shown = Image.fromarray(flat.astype(np.uint8)).resize((SIZE, SIZE), Image.Resampling.BOX)
    return np.asarray(shown, dtype=np.uint8)
