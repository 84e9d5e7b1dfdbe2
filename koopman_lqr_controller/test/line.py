"""Linear system and a near-optimal policy with a wrong model, for tests with known results."""

from typing import Any

import numpy as np
from koopman_lqr_controller.models.encoder import Dense

from koopman_lqr_controller import Encoder, LatentController, LinearModel

A = np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.1], [0.0, 0.05, 0.95]])
B = np.array([[0.0], [0.1], [0.05]])
GOAL = np.array([0.5, 0.0, 0.0])  # an equilibrium: A GOAL = GOAL


class Line:
    """x_{k+1} = A x_k + B u_k, to reach the goal within 60 steps; the reward is for closeness to the goal."""

    def reset(self, *, seed: int | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        self._x, self._steps = GOAL + 0.4 * np.random.default_rng(seed).normal(size=3), 0
        return self._x, {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        paid = float(np.exp(-np.sum((self._x - GOAL) ** 2)))
        self._x, self._steps = A @ self._x + B @ action, self._steps + 1
        return self._x, paid, False, self._steps == 60, {"outcome": "GOAL" if paid > 0.9 else "TIMEOUT"}


def learnt_controller() -> LatentController:
    """Lift 3 states to 8 latent ones and regulate with a wrong model, as learning may leave it."""
    random = np.random.default_rng(0)
    lift = random.normal(size=(8, 3))
    encoder = Encoder(
        (Dense(lift.astype(np.float32), np.zeros(8, np.float32), False),),
        (3,),
        np.zeros(3, np.float32),
        np.ones(3, np.float32),
    )
    inverse = np.linalg.pinv(lift)
    model = LinearModel(1.1 * lift @ A @ inverse + 0.3 * random.normal(size=(8, 8)) / 8, lift @ B)
    return LatentController(encoder, model, np.ones(8), np.array([0.3]), lift @ GOAL, horizon=4)
