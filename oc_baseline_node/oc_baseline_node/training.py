"""What is learnt in thesis 3.3.3: a task's sparse reward with one of several policy gradients, from several seeds.

train_one(OcRun("car_navigation", "oc_ppo", 0), Options(Path("runs/oc_training")))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from ctrl_rl_core.tasks import NavigationTask, load_navigation_task
from ctrl_rl_training.algorithms import make_algorithm
from ctrl_rl_training.environment import Environment, make_environment
from stable_baselines3.common.base_class import BaseAlgorithm

from oc_baseline_node.baselines import OcBaseline
from oc_baseline_node.mlp_value import MlpValue
from oc_baseline_node.policy_gradient import BaselineBuffer, BaselinePolicy
from oc_baseline_node.value_file import find_value, load_network


@dataclass(frozen=True)
class OcRun:
    task_name: str
    method: str
    seed: int
    value_file: Path | None = None
    gae_lambda: float = 0.95
    gamma: float = 0.98
    log_std: float = -0.5
    ent: float = 0.0
    noise: float = 0.0
    bootstrap: bool = True
    lr: float = 1e-3
    tag: str = ""

    @property
    def name(self) -> str:
        return f"{Path(self.task_name).stem}-{self.method}{self.tag}-s{self.seed}"

    @property
    def task(self) -> NavigationTask:
        return load_navigation_task(self.task_name)

    @property
    def description(self) -> dict[str, Any]:
        return {"task": self.task_name, "method": self.method, "seed": self.seed}

    def environment(self, rate: int | None = None) -> Environment:
        return make_environment(self.task, rate)

    def model(self, samples: int) -> BaseAlgorithm:
        changes: dict[str, Any] = {"gamma": self.gamma, "gae_lambda": self.gae_lambda, "rollout_buffer_class": BaselineBuffer,
            "policy_kwargs": {"log_std_init": self.log_std}, "learning_rate": self.lr}
        algorithm = self.method.split("_")[-1]
        if algorithm == "ppo": changes["ent_coef"] = self.ent
        if self.method.startswith("oc"):
            b = OcBaseline(load_network(self.value_file), self.task, self.noise)
            if self.bootstrap:
                changes["policy"] = BaselinePolicy
                changes["policy_kwargs"]["baseline"] = b
                changes |= {"vf_coef": 0.0} if algorithm == "ppo" else {"n_critic_updates": 0}
            else:
                changes["rollout_buffer_kwargs"] = {"baseline": b}
        return make_algorithm(algorithm, self.environment, self.seed, samples, **changes)

    def notes(self, model):
        return {"advantages": model.rollout_buffer.take_ranges()}
