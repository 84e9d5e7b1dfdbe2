"""Settings and methods of offline learning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

METHODS: Mapping[str, str] = {
    "bc": "behaviour cloning: what the driver did",
    "td3bc": "TD3+BC (Fujimoto, Gu 2021): a learnt critic, held to what the driver did",
    "iql": "IQL (Kostrikov, Nair, Levine 2022): expectiles of a learnt value, then weighted cloning",
    "cql": "CQL (Kumar et al. 2020): a critic that is low where the driver never was",
    "value_weight": "cloning weighted by the advantage that a value function gives each command",
    "value_model": "cloning of the commands that a value function calls best, by a model of motion from the bags",
    "value_critic": "TD3+BC whose critic learns reward and value function after a command, without bootstrapping",
}
NEEDS_VALUE = frozenset({"value_weight", "value_model", "value_critic"})
NEEDS_REWARD = frozenset({"td3bc", "iql", "cql"})

TEMPERATURES = {"value_weight": 0.15, "value_model": 0.2, "iql": 0.4}


@dataclass(frozen=True)
class LearningSettings:
    """How a policy is learnt.

    Attributes:
        method: One of `METHODS`.
        updates: Number of updates of the networks.
        batch: Transitions per update.
        hidden: Units of each of the two hidden layers.
        rate: Learning rate of Adam.
        discount: Discount per step.
        seed: Seed of weights and batches.
        expectile: Expectile of IQL's value; 0.5 is the mean.
        temperature: Advantage that multiplies a weight by e, in standard deviations (value_weight), in gains of the
            best action over the median one (value_model) or in scaled rewards (iql); None for that of `TEMPERATURES`.
        bc_alpha: Weight of the critic beside cloning, the alpha of TD3+BC.
        conservatism: Weight of CQL's penalty.
    """

    method: str
    updates: int = 5000
    batch: int = 256
    hidden: int = 128
    rate: float = 1e-3
    discount: float = 0.97
    seed: int = 0
    expectile: float = 0.8
    temperature: float | None = None
    bc_alpha: float = 2.5
    conservatism: float = 1.0

    @property
    def weight_temperature(self) -> float:
        """Temperature of the weights."""
        return TEMPERATURES.get(self.method, 1.0) if self.temperature is None else self.temperature
