"""Collection of transitions from an environment into a replay buffer, for one chunk of a run."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from koopman_lqr_controller.training.environments.benchmark_tasks import AnyEnvironment
from koopman_lqr_controller.training.replay import Replay

Act = Callable[[int, NDArray[np.generic]], NDArray[np.float32]]


def collect_transitions(
    environment: AnyEnvironment,
    replay: Replay,
    random: np.random.Generator,
    actions: int,
    episodes: int,
    act: Act,
    update: Callable[[int], None],
) -> tuple[int, int]:
    """Act, beginning with a fresh episode, and return how many actions and episodes it was.

    Args:
        environment: To act in.
        replay: Gets all steps.
        random: Gives the seeds of episodes.
        actions: To do; the last one ends its episode.
        episodes: To end with; 0 for any number.
        act: Returns the action for the number of it, from 1, and an observation.
        update: Called after each action with its number.
    """
    begun = 0
    x, _ = environment.reset(seed=int(random.integers(2**31)))
    for step in range(1, actions + 1):
        u = act(step, x)
        x_next, reward, terminated, truncated, _ = environment.step(u)
        replay.add(x, u, float(reward), bool(terminated))
        x = x_next
        ended = terminated or truncated or step == actions
        if ended:
            replay.end_episode(x_next)
            begun += 1
            x, _ = environment.reset(seed=int(random.integers(2**31)))
        update(step)
        if ended and begun == episodes:
            return step, begun
    return actions, begun
