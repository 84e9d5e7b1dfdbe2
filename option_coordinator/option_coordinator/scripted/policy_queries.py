"""Scripted policies for teams without a policy file: any legal option, or one that no other robot runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from option_coordinator.options.options import PolicyQuery
from option_coordinator.policies.joint_policy import JointOptions
from option_coordinator.policies.policy_query import PolicyFn
from option_coordinator.protocol.team import RobotSpec

SCRIPTED = ("spread", "uniform")
"""Names of the scripted policies."""
_Candidates = Callable[[int, JointOptions], JointOptions]


def uniform_policy(generator: np.random.Generator) -> PolicyFn:
    """Return a policy that samples each robot's option uniformly from the legal ones."""

    def chooses(choice: PolicyQuery) -> tuple[JointOptions, float]:
        return _each(choice, generator, lambda agent, _: np.flatnonzero(choice.legal[agent]))

    return chooses


def spread_policy(robots: Sequence[RobotSpec], generator: np.random.Generator, shared: Sequence[str] = ()) -> PolicyFn:
    """Return a policy that samples from the legal options not run by other robots, else takes the safe option.

    Args:
        robots: Robots, in the policy's order.
        generator: Random generator of the draws.
        shared: Names of options that several robots may run simultaneously.
    """
    names = [robot.agent.options for robot in robots]
    safe = [robot.safe_option for robot in robots]

    def chooses(choice: PolicyQuery) -> tuple[JointOptions, float]:
        def candidates(agent: int, options: JointOptions) -> JointOptions:
            taken = {names[other][option] for other, option in enumerate(options) if other != agent and option >= 0}
            taken -= set(shared)
            legal = np.flatnonzero(choice.legal[agent])
            free = [option for option in legal if option != safe[agent] and names[agent][option] not in taken]
            if free:
                return np.array(free)
            return np.array([safe[agent]]) if safe[agent] in legal else legal

        return _each(choice, generator, candidates)

    return chooses


def _each(choice: PolicyQuery, generator: np.random.Generator, candidates: _Candidates) -> tuple[JointOptions, float]:
    """Sample for one robot after the other, each knowing the previous choices."""
    options, log_probability = choice.running.copy(), 0.0
    for agent in np.flatnonzero(choice.choosing):
        some = candidates(int(agent), options)
        options[agent] = generator.choice(some)
        log_probability -= math.log(len(some))
    return options, log_probability
