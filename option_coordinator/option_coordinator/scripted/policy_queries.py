"""Scripted policies for teams without a policy file: any legal option, or the assignment with the least travel time."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from option_coordinator.navigation.planner import ReactivePlanner
from option_coordinator.options.options import PolicyQuery
from option_coordinator.policies.joint_policy import JointOptions
from option_coordinator.policies.policy_query import PolicyFn
from option_coordinator.teams.team_file import OBSERVED, NavigationOption, TeamFile, Work

SCRIPTED = ("spread", "uniform")
"""Names of the scripted policies."""
_LEAVES_AFTER = 5.0
"""Time until a robot has left a station after its work there [s]."""
_IDLE, _ILLEGAL = 1e4, 1e8
"""Cost of waiting, and of an illegal option [s]."""


def uniform_policy(generator: np.random.Generator) -> PolicyFn:
    """Return a policy that samples each robot's option uniformly from the legal ones."""

    def chooses(choice: PolicyQuery) -> tuple[JointOptions, float]:
        options, log_probability = choice.running.copy(), 0.0
        for agent in np.flatnonzero(choice.choosing):
            legal = np.flatnonzero(choice.legal[agent])
            options[agent] = generator.choice(legal)
            log_probability -= math.log(len(legal))
        return options, log_probability

    return chooses


def spread_policy(team: TeamFile) -> PolicyFn:
    """Return a policy that spreads a team's robots over the stations, by the least sum of travel and queueing times.

    Robots that choose together are assigned together. A station to which others are heading costs the time until they
    have left it, because a robot on its way to a queue is there sooner than one that waits where it stands.
    """
    options = tuple(team.options.values())

    def chooses(choice: PolicyQuery) -> tuple[JointOptions, float]:
        joint, agents = choice.running.copy(), np.flatnonzero(choice.choosing)
        if len(agents):
            places = choice.observation.reshape(-1, len(OBSERVED))[agents, :2]
            heading = Counter(joint[~choice.choosing].tolist())
            costs, columns = [], []
            for index, option in enumerate(options):
                costs.append(_costs(option, places, choice.legal[agents, index], heading[index]))
                columns += [index] * len(agents)
            rows, taken = linear_sum_assignment(np.concatenate(costs, axis=1))
            joint[agents[rows]] = np.array(columns)[taken]
        return joint, 0.0

    return chooses


def _costs(
    option: NavigationOption, places: NDArray[np.floating], legal: NDArray[np.bool_], heading: int
) -> NDArray[np.floating]:
    """Return the cost of an option [s] for each robot (M,) and turn at its station (M,).

    Args:
        option: The option.
        places: Positions of the choosing robots (M, 2) [m].
        legal: Whether each of them may choose it (M,).
        heading: Number of other robots that run it.
    """
    count = len(places)
    cost = np.full((count, count), _IDLE if option.work is Work.WAIT else 0.0)
    if option.station is not None:
        turns = heading + np.arange(count)
        travel = np.linalg.norm(places - option.station, axis=1) / ReactivePlanner.speed
        cost = travel[:, None] + (option.lasts + _LEAVES_AFTER) * turns
    return np.where(legal[:, None], cost, _ILLEGAL)
