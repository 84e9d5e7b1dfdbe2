"""One call of the policy beside the robots: its choice if it is one, else everybody's safe option."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from option_coordinator.options.options import Mask, Observation
from option_coordinator.policies.joint_policy import JointOptions
from option_coordinator.policies.policy_file import OptionPolicy


@dataclass(frozen=True, eq=False)
class PolicyQuery:
    """What a policy is asked: the arguments of `JointPolicy.given`."""

    observation: Observation
    choosing: Mask
    running: JointOptions
    legal: Mask


PolicyFn = Callable[[PolicyQuery], tuple[JointOptions, float]]
"""Returns options (N,), of which those of who chooses count, and the log-probability of those."""


@dataclass(frozen=True, eq=False)
class PolicyAnswer:
    """What was chosen.

    Attributes:
        options: (N,), -1 where nothing can be granted.
        log_probability: of the policy's choice, 0 where it did not choose.
        by_policy: it was the policy.
        faults: what went wrong.
    """

    options: JointOptions
    log_probability: float
    by_policy: bool
    faults: list[str] = field(default_factory=list)


def learned_policy_fn(policy: OptionPolicy, generator: np.random.Generator) -> PolicyFn:
    """Return a learned policy as a coordinator wants it."""

    def chooses(choice: PolicyQuery) -> tuple[JointOptions, float]:
        conditional = policy.joint.given(choice.observation, choice.choosing, choice.running, choice.legal)
        options = conditional.mode() if policy.greedy else conditional.sample(generator)
        return options, float(conditional.log_prob(options))

    return chooses


def query_with_fallback(choice: PolicyQuery, policy: PolicyFn, limit: float, safe: Sequence[int]) -> PolicyAnswer:
    """Ask the policy; where it fails, is too slow [s] or chooses what is not legal, take the safe options.

    A policy may be anybody's code and robots wait, so no error of it may pass.
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
