"""DeepMind control suite tasks as Gymnasium environments, observed as states or pixels, without a window."""

from __future__ import annotations

import os
import sys
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from koopman_lqr_controller.errors import KoopmanError

FRAMES = 3
"""Number of images in an observation, oldest first."""
_CAMERA = 0
_GREY = np.array((0.299, 0.587, 0.114), np.float32)
_QUICK = ("mjRND_SHADOW", "mjRND_REFLECTION", "mjRND_SKYBOX")
"""Rendering effects to disable, which makes software rendering ten times faster."""

Observation = NDArray[Any]


class ControlSuite(gymnasium.Env[Observation, NDArray[np.float32]]):
    """A task with episodes truncated at 1000 steps of the suite; the return is at most 1000.

    Observation: the suite's own, concatenated (n,) float32; or the last `FRAMES` grey images (FRAMES, size, size)
    uint8. Action: [-1, 1] for each actuator. Reward: the sum over the repeated steps.

    Args:
        domain: Domain of the suite, e.g. "cartpole".
        task: Task of the domain, e.g. "swingup".
        repeat: Number of suite steps per action.
        pixels: Rows and columns of an image; 0 for states.

    Attributes:
        dt: Hold time of an action [s].

    Raises:
        KoopmanError: Images are requested but OpenGL is unavailable.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - gymnasium's own form

    def __init__(self, domain: str, task: str, repeat: int, pixels: int = 0) -> None:
        suite = _load_suite(pixels > 0)
        self._random = np.random.RandomState(0)
        self._suite = suite.load(domain, task, task_kwargs={"random": self._random})
        self._repeat, self._pixels = repeat, pixels
        self.dt: float = repeat * self._suite.control_timestep()
        self._renderer: Any = None
        self._pictures: list[NDArray[np.uint8]] = []
        actions = self._suite.action_spec()
        self.action_space = spaces.Box(-1.0, 1.0, actions.shape, np.float32)
        self._low, self._high = actions.minimum, actions.maximum
        if pixels:
            self.observation_space: spaces.Box = spaces.Box(0, 255, (FRAMES, pixels, pixels), np.uint8)
        else:
            size = sum(int(np.prod(spec.shape)) for spec in self._suite.observation_spec().values())
            self.observation_space = spaces.Box(-np.inf, np.inf, (size,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; the same seed gives the same episode. `options` has no effect."""
        super().reset(seed=seed, options=options)
        self._random.seed(int(self.np_random.integers(2**32)))
        step = self._suite.reset()
        self._pictures = []
        return self._observe(step), {}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold an action (m,)."""
        share = 0.5 * (np.clip(np.asarray(action, dtype=float), -1.0, 1.0) + 1.0)
        control, reward = self._low + share * (self._high - self._low), 0.0
        for _ in range(self._repeat):
            step = self._suite.step(control)
            reward += step.reward
            if step.last():
                break
        terminated = step.last() and step.discount == 0.0
        return self._observe(step), reward, terminated, step.last() and not terminated, {}

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each component of an observed state."""
        parts = ((name, int(np.prod(spec.shape))) for name, spec in self._suite.observation_spec().items())
        return tuple(f"{name} {index}" for name, size in parts for index in range(size))

    @property
    def state(self) -> NDArray[np.float64]:
        """Positions and velocities of the simulated system (n,)."""
        return np.array(self._suite.physics.get_state(), dtype=np.float64)

    def place(self, state: NDArray[np.float64]) -> Observation:
        """Start an episode in a state of the simulated system (n,)."""
        step = self._suite.reset()
        with self._suite.physics.reset_context():
            self._suite.physics.set_state(state)
        self._pictures = []
        return self._observe(step._replace(observation=self._suite.task.get_observation(self._suite.physics)))

    def close(self) -> None:
        """Release the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _observe(self, step: Any) -> Observation:
        if not self._pixels:
            return np.concatenate([np.ravel(part) for part in step.observation.values()]).astype(np.float32)
        picture = self._picture()
        self._pictures = [*self._pictures, picture][-FRAMES:] if self._pictures else [picture] * FRAMES
        return np.stack(self._pictures)

    def _picture(self) -> NDArray[np.uint8]:
        import mujoco

        physics = self._suite.physics
        if self._renderer is None:
            if not hasattr(mujoco, "GLContext"):
                raise KoopmanError(
                    "pictures need OpenGL without a window: set MUJOCO_GL=egl before anything is simulated"
                )
            self._renderer = mujoco.Renderer(physics.model.ptr, self._pixels, self._pixels)
        self._renderer.update_scene(physics.data.ptr, camera=_CAMERA)
        for flag in _QUICK:
            self._renderer.scene.flags[getattr(mujoco.mjtRndFlag, flag)] = 0
        grey: NDArray[np.uint8] = (self._renderer.render() @ _GREY).astype(np.uint8)
        return grey


def suite_tasks() -> tuple[tuple[str, str], ...]:
    """Return domain and task of all tasks of the suite."""
    return tuple(_load_suite(False).ALL_TASKS)


def _load_suite(pictures: bool) -> Any:
    """Import the suite for headless use, unless MUJOCO_GL is set."""
    if "mujoco" not in sys.modules:
        os.environ.setdefault("MUJOCO_GL", "egl" if pictures else "disabled")
    from absl import logging

    logging.set_verbosity(logging.ERROR)  # its models use names deprecated in MuJoCo
    from dm_control import suite

    return suite
