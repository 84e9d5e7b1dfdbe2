"""The policy gradients compared in thesis 3.3.3, which differ only in the baseline."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

ENTROPIES = (0.01, 0.02, 0.05, 0.1)
"""Coefficients of thesis Table 3.6."""
NOISES = (0.05, 0.1, 0.2)
"""Standard deviations of thesis Fig. 3.16 [m, rad, ...]."""


@dataclass(frozen=True)
class Method:
    """A policy-gradient method.

    Attributes:
        label: Name in tables and figures.
        algorithm: "ppo" or "trpo".
        baseline: b of Eq. 3.14: "value", the on-policy V; "oc", V_oc; "corrected", an on-policy V given by V_oc plus a
            learnt correction; "stein" and "q_prop" have an action-dependent part.
        end: Bootstrap value of the n-step returns in G^lambda: V_oc ("oc") or the on-policy V ("value").
        gae_lambda: Coefficient lambda of G^lambda.
        entropy: Coefficient of the entropy bonus.
        noise: Standard deviation of noise on the state before V_oc is evaluated.
    """

    label: str
    algorithm: Literal["ppo", "trpo"] = "ppo"
    baseline: Literal["value", "oc", "corrected", "stein", "q_prop"] = "value"
    end: Literal["value", "oc"] = "value"
    gae_lambda: float = 0.95
    entropy: float = 0.0
    noise: float = 0.0

    @property
    def needs_value(self) -> bool:
        """Whether the method needs V_oc."""
        return self.baseline in ("oc", "corrected")


METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "oc_ppo": Method("PPO, OC baseline", baseline="oc", end="oc"),
        "ppo": Method("PPO"),
        "oc_corrected": Method("PPO, OC baseline with a learnt correction", baseline="corrected"),
        "oc_trpo": Method("TRPO, OC baseline", "trpo", baseline="oc", end="oc"),
        "trpo": Method("TRPO", "trpo"),
        "stein": Method("PPO, Stein", baseline="stein"),
        "q_prop": Method("PPO, Q-Prop", baseline="q_prop"),
        **{f"entropy_{c:g}": Method(f"PPO, entropy {c:g}", entropy=c) for c in ENTROPIES},
        **{f"noise_{s:g}": Method(f"PPO, OC baseline, noise {s:g}", "ppo", "oc", "oc", noise=s) for s in NOISES},
        "oc_lambda_0.7": Method("PPO, OC baseline, λ = 0.7", baseline="oc", end="oc", gae_lambda=0.7),
        "lambda_0.7": Method("PPO, λ = 0.7", gae_lambda=0.7),
        "oc_lambda_1": Method("PPO, OC baseline, λ = 1", baseline="oc", end="oc", gae_lambda=1.0),
        "oc_own_end": Method("PPO, OC baseline, G on own V", baseline="oc", end="value"),
    }
)
"""All methods by name, the most important first."""

GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "ablation": ("oc_ppo", "ppo", "oc_corrected", "oc_trpo", "trpo"),
        "baselines": ("oc_ppo", "ppo", "stein", "q_prop"),
        "noise": ("oc_ppo", *(f"noise_{s:g}" for s in NOISES)),
        "entropy": ("oc_ppo", "ppo", *(f"entropy_{c:g}" for c in ENTROPIES)),
        "ends": ("oc_ppo", "oc_corrected", "oc_lambda_0.7", "lambda_0.7", "oc_lambda_1", "oc_own_end", "ppo"),
    }
)
"""Comparisons: Fig. 3.10, 3.12 and 3.14, Fig. 3.13, Fig. 3.16, Table 3.6, and the bootstrap of G^lambda. `oc_corrected`
is not in the thesis."""
