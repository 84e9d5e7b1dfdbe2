"""Estimates a joint policy's return from bags of other policies, before robots run it.

Fitted Q evaluation (Le, Voloshin, Yue 2019) over option steps, with gamma^tau in place of gamma. Rewards after an
episode's truncation do not count, for the policy as well as for the recorded deciders.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
import torch
from ctrl_rl_learning.study import Estimate, estimate
from ctrl_rl_learning.torch import gradient_step, polyak_update
from numpy.typing import NDArray
from torch import Tensor

from option_coordinator.data.bag_trajectory import Recording, TeamLayout
from option_coordinator.data.trajectory import OptionTrajectory
from option_coordinator.errors import OptionError
from option_coordinator.options.options import PolicyQuery
from option_coordinator.policies.policy_file import OptionPolicy
from option_coordinator.training.heads.head_parts import ValueNetwork

Array = NDArray[np.float64]
_DRAWS = 4
_BATCH, _RATE, _SHARE = 256, 1e-3, 0.05
LEAST_EPISODES = 10


@dataclass(frozen=True)
class TeamReport:
    """Estimates of discounted returns from bags.

    Attributes:
        driver: Return in the bags.
        policy: Return of the policy, estimated by fitted Q evaluation.
        gain: Return of the policy minus that of the bags.
        episodes: Number of episodes in the bags.
    """

    driver: Estimate
    policy: Estimate
    gain: Estimate
    episodes: int

    @property
    def better(self) -> bool:
        """Whether the policy is significantly better than the deciders in the bags."""
        return self.gain.low > 0.0


def evaluate_offline(
    recordings: Sequence[Recording],
    policy: OptionPolicy,
    *,
    updates: int = 1500,
    fits: int = 3,
    seed: int = 0,
    tell: Callable[[int], object] = lambda _: None,
) -> TeamReport:
    """Estimate the return of a policy from bags, without running it.

    Args:
        recordings: Decisions of others, read from bags by `recordings`.
        policy: Policy of the same team; its options are sampled.
        updates: Number of updates of each fit.
        fits: Number of fits; their spread is part of the intervals.
        seed: Seed of fits, sampling and resampling.
        tell: Called with the number of updates since the last call.

    Raises:
        OptionError: There are too few episodes, or they belong to another team.
    """
    if len(recordings) < LEAST_EPISODES:
        missing = LEAST_EPISODES - len(recordings)
        raise OptionError(f"{len(recordings)} episodes are too few for an evaluation: record {missing} more")
    team = TeamLayout.of(policy.agents)
    for recording in recordings:
        recording.team.check_against(team, "a bag")
    trajectory = OptionTrajectory.joined([recording.trajectory for recording in recordings])
    earned = _returns(trajectory)
    random = np.random.default_rng(seed)
    found = np.array([_fit(trajectory, policy, updates, seed + k, earned, tell) for k in range(fits)])
    starts = _starts(trajectory)
    return TeamReport(
        driver=estimate(earned[starts][None], random),
        policy=estimate(found, random),
        gain=estimate(found - earned[starts], random),
        episodes=len(starts),
    )


def _starts(trajectory: OptionTrajectory) -> NDArray[np.intp]:
    """Return the index of the first step of each episode (episodes,)."""
    return np.concatenate(([0], np.flatnonzero(trajectory.last)[:-1] + 1))


def _returns(trajectory: OptionTrajectory) -> Array:
    """Return the discounted return from each step to the end of its episode (T,)."""
    out, ahead = np.zeros(len(trajectory)), 0.0
    for step in range(len(out) - 1, -1, -1):
        ahead = 0.0 if trajectory.last[step] else ahead
        out[step] = ahead = trajectory.reward[step] + trajectory.discount[step] * ahead
    return out


def _fit(
    trajectory: OptionTrajectory,
    policy: OptionPolicy,
    updates: int,
    seed: int,
    earned: Array,
    tell: Callable[[int], object],
) -> Array:
    """Return the policy's value at the first step of each episode (episodes,), from one fit.

    Targets are clipped to the range of recorded returns, so that the fit cannot diverge outside the data.
    """
    generator = np.random.default_rng(seed)
    scale = max(float(np.abs(earned).max()), 1e-9)
    least, most = float(earned.min()) / scale, float(earned.max()) / scale
    inner = ~trajectory.last
    starts = _starts(trajectory)
    own = np.repeat(trajectory.options[:, None], _DRAWS, axis=1)
    for step in np.flatnonzero(inner):
        choosing = trajectory.next_present[step] & (trajectory.next_running[step] < 0)
        seen, legal = trajectory.next_observation[step], trajectory.next_legal[step]
        own[step] = _draw(policy, PolicyQuery(seen, choosing, trajectory.next_running[step], legal), generator)
    first = np.array([_draw(policy, _query(trajectory, start), generator) for start in starts])
    seen, after, given, chosen, paid, onward = (
        torch.from_numpy(np.asarray(array))
        for array in (
            trajectory.observation.astype(np.float32),
            trajectory.next_observation.astype(np.float32),
            trajectory.options,
            own,
            (trajectory.reward / scale).astype(np.float32),
            np.where(inner, trajectory.discount, 0.0).astype(np.float32),
        )
    )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = ValueNetwork(trajectory.observation.shape[1], policy.joint.counts)
        slow = deepcopy(network)
        optimizer = torch.optim.Adam(network.parameters(), lr=_RATE, fused=True)
        for _ in range(updates):
            rows = torch.from_numpy(generator.integers(len(trajectory), size=_BATCH))
            with torch.no_grad():
                target = paid[rows] + onward[rows] * _mean(slow, after[rows], chosen[rows]).clamp(least, most)
            loss = torch.nn.functional.mse_loss(network(seen[rows], given[rows]), target)
            gradient_step(optimizer, loss)
            polyak_update(slow, network, _SHARE)
            tell(1)
        with torch.no_grad():
            values = _mean(slow, seen[torch.from_numpy(starts)], torch.from_numpy(first)).clamp(least, most)
    return values.numpy().astype(np.float64) * scale


def _query(trajectory: OptionTrajectory, step: int) -> PolicyQuery:
    """Return the policy query of a step."""
    seen, legal = trajectory.observation[step], trajectory.legal[step]
    return PolicyQuery(seen, trajectory.choosing[step], trajectory.running[step], legal)


def _draw(policy: OptionPolicy, query: PolicyQuery, generator: np.random.Generator) -> NDArray[np.int64]:
    """Return samples of a policy (draws, N)."""
    conditional = policy.joint.valid(query)
    return np.stack([conditional.sample(generator) for _ in range(_DRAWS)])


def _mean(network: ValueNetwork, observation: Tensor, options: Tensor) -> Tensor:
    """Return the mean value (B,) over sampled joint options (B, draws, N) at observations (B, D)."""
    values = [network(observation, options[:, draw]) for draw in range(_DRAWS)]
    return torch.stack(values).mean(dim=0)
