"""Roll-outs of a policy in an environment: trajectories for learning, episodes for evaluation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from option_coordinator.data.trajectory import OptionTrajectory
from option_coordinator.environments.option_env import OptionEnvironment
from option_coordinator.options.options import Decision
from option_coordinator.policies.joint_policy import JointPolicy


@dataclass
class OptionEpisode:
    """Totals of one episode.

    Attributes:
        returned: Undiscounted sum of the low-level rewards.
        steps: Number of low-level steps (makespan T).
        decisions: Number of option steps.
        option_reward: Sum of the option steps' discounted rewards r_kappa.
        last_reward: Sum of the option steps' last low-level rewards.
        terminated: Whether the task ended, rather than being truncated.
        figures: Metrics of the task, by name.
    """

    returned: float = 0.0
    steps: int = 0
    decisions: int = 0
    option_reward: float = 0.0
    last_reward: float = 0.0
    terminated: bool = False
    figures: dict[str, Any] = field(default_factory=dict)

    def add(self, decision: Decision) -> None:
        """Add the rewards and steps that led to a decision."""
        self.returned += sum(decision.rewards)
        self.steps += decision.duration
        self.decisions += 1
        self.option_reward += decision.reward
        self.last_reward += decision.rewards[-1]
        self.terminated = decision.terminated


class RollOut:
    """Rolls out a policy over consecutive episodes, in parts.

    Args:
        environment: Environment of the roll-out.
        generator: Random generator of worlds and policy samples.

    Attributes:
        samples: Number of low-level steps so far.
        finished: Episodes that have ended.
    """

    def __init__(self, environment: OptionEnvironment, generator: np.random.Generator) -> None:
        self._environment = environment
        self._generator = generator
        self._decision = environment.reset(generator)
        self._episode = OptionEpisode()
        self.samples = 0
        self.finished: list[OptionEpisode] = []

    def collect(self, policy: JointPolicy, samples: int) -> OptionTrajectory:
        """Collect option steps over at least `samples` low-level steps; the next call continues the last episode."""
        steps = []
        enough = self.samples + samples
        while self.samples < enough:
            before = self._decision
            conditional = policy.valid(before)
            options = conditional.sample(self._generator)
            after = self._environment.step(before.named(options))
            steps.append((before, options, float(conditional.log_prob(options)), after))
            self._episode.add(after)
            self.samples += after.duration
            if after.over:
                self._episode.figures = self._environment.figures()
                self.finished.append(self._episode)
                self._episode = OptionEpisode()
                after = self._environment.reset(self._generator)
            self._decision = after
        return OptionTrajectory.of(steps)


def play_episodes(
    environment: OptionEnvironment,
    choose: Callable[[Decision], dict[str, int]],
    seeds: range,
    at_end: Callable[[Decision], object] = lambda _: None,
) -> Iterator[OptionEpisode]:
    """Play one episode per seed with any policy; `at_end` is called with the final decision of each episode."""
    for seed in seeds:
        decision, episode = environment.reset(seed), OptionEpisode()
        while not decision.over:
            decision = environment.step(choose(decision))
            episode.add(decision)
        at_end(decision)
        episode.figures = environment.figures()
        yield episode


class JointDecisionPolicy:
    """Adapts a joint policy to `DecisionPolicy`.

    Args:
        policy: Joint policy.
        generator: Random generator for sampling; None for the most likely options.
    """

    def __init__(self, policy: JointPolicy, generator: np.random.Generator | None = None) -> None:
        self._policy = policy
        self._generator = generator

    def __call__(self, decision: Decision) -> dict[str, int]:
        """Return an option for each ready agent."""
        return decision.named(self._policy.choose(decision, self._generator)[0])
