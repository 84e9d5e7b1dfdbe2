"""PPO that stores the action reported by the environment in place of the one it chose."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback, CallbackList


class ToldActions(BaseCallback):
    """Replaces actions changed by a shield in the buffer by their `told_action`, with its current probability.

    The gradient then refers to the commands that the robot executed.
    """

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        rows = [row for row, info in enumerate(infos) if info.get("changed", 0.0) > 0.0]
        if rows:
            actions, seen = self.locals["actions"], self.locals["obs_tensor"][rows]
            actions[rows] = np.array([infos[row]["told_action"] for row in rows])
            policy: Any = self.model.policy
            with torch.no_grad():
                _, known, _ = policy.evaluate_actions(seen, torch.as_tensor(actions[rows]))
            self.locals["log_probs"][rows] = known
        return True


class ToldPPO(PPO):
    """PPO with `ToldActions`."""

    def collect_rollouts(self, env: Any, callback: BaseCallback, *rest: Any, **named: Any) -> bool:
        """Collect steps as PPO does."""
        both = CallbackList([callback, ToldActions()])
        both.init_callback(self)
        return super().collect_rollouts(env, both, *rest, **named)
