"""Option-level joint trajectories (thesis Definition 1): recorded decisions for learning.

A step kappa has s_kappa, o_kappa, the agents that chose, r_kappa and gamma^tau, from a simulation or from a bag of
`joint_option_step` messages.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from option_coordinator.errors import OptionError
from option_coordinator.options.options import Mask

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OptionTrajectory:
    """T consecutive option steps of N agents with at most K options, from one or several episodes.

    Attributes:
        observation: Joint observation s_kappa (T, D).
        options: Joint option o_kappa, including options that continue (T, N); -1 for absent agents.
        choosing: Whether each agent chose, U_kappa (T, N).
        legal: Whether each option was legal for its agent (T, N, K).
        log_prob: Log-probability log pi-hat(o_U | o_not-U, s) at the time of the choice (T,).
        reward: Discounted joint reward until the next decision, r_kappa = sum_i gamma^i r_i (T,).
        duration: Number tau of low-level steps until the next decision (T,).
        discount: Discount gamma^tau of the next decision (T,).
        next_observation: Joint observation s_kappa+1 at the next decision (T, D).
        next_running: Option that continues at the next decision; -1 for agents that choose or are absent (T, N).
        next_present: Whether each agent is present at the next decision (T, N).
        next_legal: Whether each option is legal at the next decision (T, N, K).
        terminated: Whether the task ended, which gives the next decision value 0 (T,).
        last: Whether this is the last step of its episode or trajectory (T,).
    """

    observation: NDArray[np.float32]
    options: NDArray[np.int64]
    choosing: Mask
    legal: Mask
    log_prob: Array
    reward: Array
    duration: NDArray[np.int64]
    discount: Array
    next_observation: NDArray[np.float32]
    next_running: NDArray[np.int64]
    next_present: Mask
    next_legal: Mask
    terminated: Mask
    last: Mask

    def __post_init__(self) -> None:
        lengths = {field.name: len(getattr(self, field.name)) for field in fields(self)}
        if len(set(lengths.values())) > 1:
            raise OptionError(f"trajectory: parts of different lengths {lengths}")

    def __len__(self) -> int:
        return len(self.reward)

    @property
    def running(self) -> NDArray[np.int64]:
        """Option that continued at each decision; -1 for agents that chose or were absent (T, N)."""
        return np.where(self.choosing, -1, self.options)

    @property
    def present(self) -> Mask:
        """Whether each agent was present at each decision (T, N)."""
        return self.options != -1

    @classmethod
    def of(cls, steps: Sequence[tuple[Any, Any, float, Any]]) -> Self:
        """Create a trajectory from option steps; the last step is marked as an end even if the episode continues.

        Args:
            steps: For each step, the decision, the joint option (N,), its log-probability and the next decision.
                Decisions are `Decision` objects, or have the same attributes.

        Raises:
            OptionError: There are no steps.
        """
        if not steps:
            raise OptionError("no option step was recorded")
        before, options, log_prob, after = zip(*steps, strict=True)
        seen = {name: _rows(before, name) for name in ("observation", "choosing", "legal")}
        came = {name: _rows(after, name) for name in ("reward", "duration", "discount", "terminated")}
        follows = {f"next_{name}": _rows(after, name) for name in ("observation", "running", "present", "legal")}
        last = _rows(after, "over")
        last[-1] = True
        probabilities = np.array(log_prob, dtype=float)
        return cls(options=np.stack(options), log_prob=probabilities, last=last, **seen, **came, **follows)

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Concatenate trajectories; each keeps its end.

        Raises:
            OptionError: There are no trajectories.
        """
        if not parts:
            raise OptionError("there is no trajectory to join")
        return cls(
            **{field.name: np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)}
        )


def _rows(decisions: Sequence[Any], name: str) -> NDArray[Any]:
    """Stack an attribute of the decisions (T, ...)."""
    return np.stack([np.asarray(getattr(decision, name)) for decision in decisions])


def advantages(trajectory: OptionTrajectory, values: Array, next_values: Array, gae_lambda: float) -> Array:
    """Return G^lambda - V of each option step (T,): generalised advantages with gamma^tau in place of gamma (Eq. 5.4).

    Args:
        trajectory: Trajectory of T option steps.
        values: Values V(s_kappa) (T,).
        next_values: Values V(s_kappa+1) (T,); ignored at the end of the task.
        gae_lambda: Coefficient lambda of the generalised advantage estimate.
    """
    onward = trajectory.discount * ~trajectory.terminated
    errors = trajectory.reward + onward * next_values - values
    out, ahead = np.empty(len(errors)), 0.0
    for step in range(len(errors) - 1, -1, -1):
        if trajectory.last[step]:
            ahead = 0.0
        ahead = errors[step] + trajectory.discount[step] * gae_lambda * ahead
        out[step] = ahead
    return out
