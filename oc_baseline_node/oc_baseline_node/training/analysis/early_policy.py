"""An early policy, which reaches the goal about every second time; thesis Table 3.7 compares its gradients.

The thesis takes one that meets goal and trap equally often; the trap of `quad_trap` is hardly ever met (its least
thrust, 14 N, is more than the weight), so crashes take its part.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ctrl_rl_training.sb3.algorithms import ROLL_OUT
from ctrl_rl_training.sb3.training import Recorder
from stable_baselines3.common.base_class import BaseAlgorithm

from oc_baseline_node.errors import OcError
from oc_baseline_node.training.experiments.runs import OcRun

_LIMIT = 150
"""Roll-outs after which the search ends."""
_SHARE = (1.0 / 3.0, 2.0 / 3.0)
"""Least and largest fraction of the episodes that end in the goal."""


def find_early_policy(
    run: OcRun, progress: Callable[[], object] = lambda: None
) -> tuple[BaseAlgorithm, dict[str, int]]:
    """Learn until a roll-out meets the goal about every second time.

    Args:
        run: Run that is trained.
        progress: Function called after each roll-out.

    Returns:
        The algorithm, as it then is, and how the last roll-out's episodes ended.

    Raises:
        OcError: it never does.
    """
    model: Any = run.model(ROLL_OUT * _LIMIT)
    model.set_random_seed(run.seed)
    for _ in range(_LIMIT):
        recorder = Recorder()
        model.learn(ROLL_OUT, callback=recorder, reset_num_timesteps=False)
        progress()
        ended = recorder.outcomes
        if _SHARE[0] <= ended.count("GOAL") / max(1, len(ended)) <= _SHARE[1]:
            return model, {name: ended.count(name) for name in sorted(set(ended))}
    model.env.close()
    raise OcError(f"no early policy of {run.name} meets the goal about every second time: try another seed")
