"""Queries a policy, and falls back to the safe options if its answer is invalid."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from option_coordinator.options.options import PolicyQuery
from option_coordinator.policies.joint_policy import JointOptions
from option_coordinator.policies.policy_file import OptionPolicy

PolicyFn = Callable[[PolicyQuery], tuple[JointOptions, float]]
"""Function that returns options (N,), used for the choosing agents only, and their log-probability."""


@dataclass(frozen=True, eq=False)
class PolicyAnswer:
    """Answer to a policy query.

    Attributes:
        options: Options (N,); -1 if nothing can be granted.
        log_probability: Log-probability of the policy's choice; 0 if the policy failed.
        by_policy: Whether the policy chose; otherwise these are the safe options.
        faults: Reasons why the policy failed, as keys of counters.
    """

    options: JointOptions
    log_probability: float
    by_policy: bool
    faults: list[str] = field(default_factory=list)


def learned_policy_fn(policy: OptionPolicy, generator: np.random.Generator) -> PolicyFn:
    """Adapt a learned policy for a coordinator."""

    def chooses(choice: PolicyQuery) -> tuple[JointOptions, float]:
        options, conditional = policy.joint.choose(choice, None if policy.greedy else generator)
        return options, float(conditional.log_prob(options))

    return chooses


def query_with_fallback(choice: PolicyQuery, policy: PolicyFn, limit: float, safe: Sequence[int]) -> PolicyAnswer:
    """Query the policy; use the safe options if it fails, exceeds the time limit [s] or chooses an illegal option.

    Every error is caught, because robots wait for the answer and a policy may be arbitrary code.
    """
    began = time.perf_counter()
    try:
        options, log_probability = policy(choice)
        fault = _fault(choice, np.asarray(options), log_probability)
    except Exception as error:
        fault = f"policy failed: {type(error).__name__}"
    if not fault and time.perf_counter() - began > limit:
        fault = "policy too slow"
    if not fault:
        return PolicyAnswer(np.asarray(options), log_probability, True)
    legal = choice.legal[np.arange(len(safe)), safe]
    return PolicyAnswer(np.where(choice.choosing & legal, safe, -1), 0.0, False, [fault])


def _fault(choice: PolicyQuery, options: JointOptions, log_probability: float) -> str:
    if not math.isfinite(log_probability):
        return "policy not finite"
    if options.shape != choice.choosing.shape or options.dtype.kind not in "iu":
        return "policy of another size"
    chosen = options[choice.choosing]
    if np.any((chosen < 0) | (chosen >= choice.legal.shape[1])):
        return "illegal option"
    return "" if choice.legal[np.flatnonzero(choice.choosing), chosen].all() else "illegal option"
