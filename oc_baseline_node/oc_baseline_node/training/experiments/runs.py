"""The runs of thesis 3.3.3: learning a task's sparse reward with several policy gradients, from several seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
from ctrl_rl_core.values import check_function
from ctrl_rl_learning.sb3 import Environment, SimulatedRun, Vector, fits_fleet, make_algorithm, make_environment
from ctrl_rl_learning.study import find_method
from stable_baselines3.common.base_class import BaseAlgorithm

from ctrl_rl_core import NavigationTask
from oc_baseline_node.errors import OcError
from oc_baseline_node.training.baselines.control_variates import QPropPpo, SteinPpo
from oc_baseline_node.training.baselines.policy_gradient import (
    BaselineBuffer,
    BaselinePolicy,
    CorrectedPolicy,
    FrozenValueTrpo,
    OcBaseline,
)
from oc_baseline_node.training.experiments.methods import METHODS, Method
from oc_baseline_node.values.mlp_value import MlpValue
from oc_baseline_node.values.value_file import find_value, load_network
from sim_bridge import NavigationEnv


class PaidTimeOut(gymnasium.Wrapper[Vector, Vector, Vector, Vector]):
    """Treats a time-out with a reward as a terminal state, like goal and collision.

    A time-out without a reward only truncates the episode, and the return is bootstrapped from the last state.
    """

    def __init__(self, environment: Environment) -> None:
        super().__init__(environment)
        bare = environment.unwrapped
        assert isinstance(bare, NavigationEnv)
        self._paid = bare.task.rewards.timeout != 0.0

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Hold an action for the task's time step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self._paid and truncated:
            terminated, truncated = True, False
        return observation, float(reward), terminated, truncated, info


@dataclass(frozen=True)
class OcRun(SimulatedRun):
    """A run of one policy-gradient method.

    Attributes:
        task: Task to learn.
        method_name: One of `METHODS`.
        seed: Random seed.
        value: File of V_oc; the shipped network by default.
        engine: "planar" to train in a fleet if the task permits, or "auto" for one robot at a time in PyBullet.
    """

    task: NavigationTask
    method_name: str
    seed: int
    value: Path | None = None
    engine: str = "planar"

    @property
    def name(self) -> str:
        """Name of the run and of its folder."""
        return f"{self.task.name}-{self.method_name}-s{self.seed}"

    @property
    def method(self) -> Method:
        """The method.

        Raises:
            OcError: The method is unknown.
        """
        method: Method = find_method(METHODS, self.method_name, OcError)
        return method

    @property
    def description(self) -> dict[str, Any]:
        """Description of the run for its result."""
        value = self.network.digest if self.method.needs_value else None
        return {
            "task": self.task.name,
            "method": self.method_name,
            "seed": self.seed,
            "discount": self.discount,
            "value_digest": value,
            **({"engine": self.engine} if self.in_fleet else {}),
        }

    @property
    def in_fleet(self) -> bool:
        """Whether the run trains in a fleet."""
        return self.engine == "planar" and fits_fleet(self.task)

    @property
    def timeout_ends(self) -> bool:
        """Whether the task has a reward for a time-out, see `PaidTimeOut`."""
        return self.task.rewards.timeout != 0.0

    @property
    def network(self) -> MlpValue:
        """V_oc of the task.

        Raises:
            OcError: The file is missing, or V_oc belongs to another version of the task.
            ValueFunctionError: V_oc belongs to another task or has other states.
        """
        file = find_value(self.value or self.task.name)
        value = load_network(file)
        if not check_function(value, self.task, value.kind):
            raise OcError(f"{file}: is of another version of '{self.task.name}': make it with 'oc data' and 'oc fit'")
        return value

    @property
    def discount(self) -> float:
        """Discount per step: that of V_oc, for all compared methods; without V_oc the task's.

        Raises:
            OcError: As for `network`, or neither V_oc nor the task provides a discount.
        """
        if self.method.needs_value or self.value is not None:
            return float(self.network.manifest["discount"])
        if self.task.optimal_control is None:
            raise OcError(f"task '{self.task.name}' has no 'optimal_control.discount' to learn with: add it")
        return self.task.optimal_control.discount

    def baseline(self) -> OcBaseline:
        """Return b(s) = V_oc(x). Errors as for `network`."""
        return OcBaseline(self.network, self.task, self.method.noise)

    def environment(self, rate: int | None = None) -> Environment:
        """Create the task's environment with the task's rewards."""
        return make_environment(self.task, rate, PaidTimeOut)

    def model(self, samples: int) -> BaseAlgorithm:
        """Create the untrained algorithm with its environments, for a number of samples. Errors as for `network`."""
        method = self.method
        changes: dict[str, Any] = {
            "gamma": self.discount,
            "gae_lambda": method.gae_lambda,
            "rollout_buffer_class": BaselineBuffer,
        }
        if method.entropy > 0.0:
            changes["ent_coef"] = method.entropy
        if method.baseline == "stein":
            changes["kind"] = SteinPpo
        elif method.baseline == "q_prop":
            changes |= {"kind": QPropPpo, "replay_size": samples}
        elif method.baseline == "oc" and method.end == "oc":
            changes |= {"policy": BaselinePolicy, "policy_kwargs": {"baseline": self.baseline()}}
            if method.algorithm == "trpo":
                changes |= {"kind": FrozenValueTrpo, "n_critic_updates": 0}
            else:
                changes["vf_coef"] = 0.0
        elif method.baseline == "corrected":
            changes |= {"policy": CorrectedPolicy, "policy_kwargs": {"baseline": self.baseline()}}
        elif method.baseline == "oc":
            changes["rollout_buffer_kwargs"] = {"baseline": self.baseline()}
        return make_algorithm(method.algorithm, self.environments(method.algorithm), self.seed, samples, **changes)

    def notes(self, model: BaseAlgorithm) -> dict[str, Any]:
        """Return the `advantages` of each roll-out since the last call, see `BaselineBuffer.ranges`."""
        buffer: Any = model.rollout_buffer  # type: ignore[attr-defined]
        return {"advantages": buffer.take_ranges()}


def oc_runs(
    task: NavigationTask,
    methods: Sequence[str] = tuple(METHODS),
    seeds: int = 5,
    value: Path | None = None,
    engine: str = "planar",
) -> list[OcRun]:
    """Return all runs of a task, the most important ones first."""
    ordered = sorted(methods, key=list(METHODS).index)
    return [OcRun(task, method, seed, value, engine) for method in ordered for seed in range(seeds)]
