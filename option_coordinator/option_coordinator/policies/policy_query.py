"""One call of the policy beside the robots: its choice if it is one, else everybody's safe option."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from option_coordinator.options.options import Mask, Observation
from option_coordinator.policies.joint_policy import Options
from option_coordinator.policies.policy_file import OptionPolicy


@dataclass(frozen=True, eq=False)
class Choice:
    """What a policy is asked: the arguments of `JointPolicy.given`."""

    observation: Observation
    choosing: Mask
    running: Options
    legal: Mask


Chooses = Callable[[Choice], tuple[Options, float]]
"""Returns options (N,), of which those of who chooses count, and the log-probability of those."""


@dataclass(frozen=True, eq=False)
class Chosen:
    """What was chosen.

    Attributes:
        options: (N,), -1 where nothing can be granted.
        log_probability: of the policy's choice, 0 where it did not choose.
        by_policy: it was the policy.
        faults: what went wrong.
    """

    options: Options
    log_probability: float
    by_policy: bool
    faults: list[str] = field(default_factory=list)


def policy_chooser(policy: OptionPolicy, generator: np.random.Generator) -> Chooses:
    """Return a learned policy as a coordinator wants it."""

    def chooses(choice: Choice) -> tuple[Options, float]:
        conditional = policy.joint.given(choice.observation, choice.choosing, choice.running, choice.legal)
        options = conditional.mode() if policy.greedy else conditional.sample(generator)
        return options, float(conditional.log_prob(options))

    return chooses


def choose_or_safe(choice: Choice, policy: Chooses, limit: float, safe: Sequence[int]) -> Chosen:
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
        return Chosen(np.asarray(options), log_probability, True)
    legal = choice.legal[np.arange(len(safe)), safe]
    return Chosen(np.where(choice.choosing & legal, safe, -1), 0.0, False, [fault])


def _fault(choice: Choice, options: Options, log_probability: float) -> str:
    if not math.isfinite(log_probability):
        return "policy not finite"
    if options.shape != choice.choosing.shape or options.dtype.kind not in "iu":
        return "policy of another size"
    chosen = options[choice.choosing]
    if np.any((chosen < 0) | (chosen >= choice.legal.shape[1])):
        return "illegal option"
    return "" if choice.legal[np.flatnonzero(choice.choosing), chosen].all() else "illegal option"
