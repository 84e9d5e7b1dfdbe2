"""The compared ways: same networks, samples and seeds, different uses of the value, one setting for all tasks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

GAMMA = 0.99
"""Discount per step, for all ways."""
LEARNERS = ("ppo", "sac")
"""Learners of the ladder."""


@dataclass(frozen=True)
class Variant:
    """Way to use the time to reach, or to learn without it.

    Attributes:
        label: Name in tables and pictures.
        reward: Reward beside the task's sparse one: "none"; "distance", minus the distance to the goal; "ttr", minus
            the time to reach (thesis Eq. 3.9); or one of `ttr_reward_node.rewards.progress.PAYS`.
        of: Potential phi that measures progress: the time to reach, MPC's time to go, the distance in seconds, or
            that of the shortest path round the obstacles.
        baseline: Use of V = 1000 gamma^(phi/dt) by the policy gradient: "frozen" baseline, baseline with a learnt
            "corrected" part, or critic that "begins" as V.
        gae_lambda: Lambda of the returns.
        starts: Starts of training episodes: the task's own, or sublevel sets of phi that "grow".
        demonstrations: Whether the policy first imitates the greedy control of phi.
    """

    label: str
    reward: Literal["none", "distance", "ttr", "progress", "best_progress", "shaping"] = "none"
    of: Literal["time to reach", "time to go", "distance", "geodesic"] = "time to reach"
    baseline: Literal["learnt", "frozen", "corrected", "begins"] = "learnt"
    gae_lambda: float = 0.95
    starts: Literal["task", "grow"] = "task"
    demonstrations: bool = False

    @property
    def learners(self) -> tuple[str, ...]:
        """Learners that support this way."""
        return (
            LEARNERS if self.baseline == "learnt" and self.gae_lambda == 0.95 and not self.demonstrations else ("ppo",)
        )

    @property
    def needs_value(self) -> bool:
        """Whether this way uses the time to reach."""
        return (self.reward not in ("none", "distance") and self.of == "time to reach") or self.uses_states

    @property
    def needs_mpc(self) -> bool:
        """Whether this way uses MPC's time to go."""
        return self.of == "time to go"

    @property
    def uses_states(self) -> bool:
        """Whether baseline, starts or demonstrations use the time to reach."""
        return self.baseline != "learnt" or self.starts == "grow" or self.demonstrations


WAYS: Mapping[str, Variant] = MappingProxyType(
    {
        "best_progress": Variant("best progress of time to reach", "best_progress"),
        "sparse": Variant("sparse"),
        "distance": Variant("distance", "distance"),
        "progress": Variant("progress of time to reach", "progress"),
        "best_progress_distance": Variant("best progress of distance", "best_progress", "distance"),
        "best_progress_geodesic": Variant("best progress of geodesic distance", "best_progress", "geodesic"),
        "progress_distance": Variant("progress of distance", "progress", "distance"),
        "ttr": Variant("-time to reach (Eq. 3.9)", "ttr"),
        "v_corrected": Variant("V as baseline, corrected", baseline="corrected"),
        "shaping": Variant("shaping by time to reach", "shaping"),
        "v_frozen": Variant("V as frozen baseline", baseline="frozen"),
        "v_begins": Variant("V as initial critic", baseline="begins"),
        "growing_starts": Variant("starts that grow with V", starts="grow"),
        "demonstrations": Variant("demonstrations by V", demonstrations=True),
        "best_progress_lambda_0.7": Variant("best progress, λ = 0.7", "best_progress", gae_lambda=0.7),
        "best_progress_mpc": Variant("best progress of MPC's time to go", "best_progress", "time to go"),
        "v_corrected_lambda_0.7": Variant("V corrected, λ = 0.7", baseline="corrected", gae_lambda=0.7),
    }
)
"""All ways by name, the most informative first."""
BY_DEFAULT = tuple(name for name, way in WAYS.items() if not way.needs_mpc)
"""Default ways, without MPC, which takes minutes per task and cannot handle every world."""
MAIN = (
    "best_progress",
    "sparse",
    "distance",
    "progress",
    "best_progress_distance",
    "best_progress_geodesic",
    "progress_distance",
    "ttr",
    "v_corrected",
)
"""Ways that the figure shows."""
