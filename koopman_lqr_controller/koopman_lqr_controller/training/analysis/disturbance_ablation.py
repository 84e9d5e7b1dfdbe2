"""Ablation of a model's prediction error in a corridor: the same starts under different disturbances.

Each state is observed twice, which gives the error floor due to sensor noise; a linear model fitted to the same steps
gives the error floor of any linear model of these latents.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from koopman_lqr_controller.models.prediction import horizon_errors, law_error, linear_floor, noise_floor
from koopman_lqr_controller.policies.koopman_policy import ClosedLoopModel
from koopman_lqr_controller.training.analysis.policy_world import run_episode
from koopman_lqr_controller.training.environments.corridor import Conditions, Corridor, Vector

DISTURBANCES: Mapping[str, Conditions] = {
    "none": Conditions(noise=0.0),
    "noise": Conditions(),
    "noise and drop-out": Conditions(dropout=0.1),
    "noise and delay": Conditions(delay=0.1),
}
_SEED = 8_000_000


def ablate_disturbances(
    loop: ClosedLoopModel,
    make: Callable[[Conditions], Corridor],
    noises: Sequence[float],
    episodes: int,
    disturbances: Mapping[str, Conditions] = DISTURBANCES,
    on_progress: Callable[[str], None] = lambda _: None,
) -> list[dict[str, Any]]:
    """Return the prediction errors of a policy's model under disturbances.

    Args:
        loop: Closed loop of the policy.
        make: Creates the corridor for a robot.
        noises: Standard deviations of the action noise, evaluated separately because the change per step depends on
            them.
        episodes: Number of episodes per noise level, with the same starts under all disturbances.
        disturbances: Conditions of the robot by name.
        on_progress: Called with the name of each part before it starts.

    Returns:
        For each disturbance and noise level: `name`, `noise`, `steps` and one-step errors relative to persistence:
            `model`, `law` (the error in K z), `linear_floor` and `noise_floor`.
    """
    out = []
    for name, conditions in disturbances.items():
        corridor = make(conditions)
        try:
            for index, noise in enumerate(noises):
                on_progress(f"disturbance: {name}, noise {noise:g}")
                first = _SEED + index * episodes
                out.append({"name": name, "noise": noise, **_errors(loop, corridor, noise, first, episodes)})
        finally:
            corridor.close()
    return out


def _errors(loop: ClosedLoopModel, corridor: Corridor, noise: float, first: int, episodes: int) -> dict[str, float]:
    z, again, u = [], [], []
    for seed in range(first, first + episodes):
        looks: list[Vector] = []

        def look(looks: list[Vector] = looks) -> None:
            looks.append(corridor.observe())

        episode = run_episode(loop, corridor, seed, noise, look)
        z.append(loop.latent(episode.x))
        again.append(loop.latent(np.array(looks)))
        u.append(episode.u)
    return {
        "steps": sum(len(each) for each in u),
        "model": horizon_errors(loop.predict, z, u, 1)[0],
        "law": law_error(loop.predict, loop.gain, z, u),
        "linear_floor": linear_floor(z, u),
        "noise_floor": noise_floor(z, again),
    }
