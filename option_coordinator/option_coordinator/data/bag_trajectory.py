"""Option-level joint trajectories for learning, from bags of `joint_option_step` messages.

    for recording in recordings(Path("runs/mine/bag")):
        recording.digest, recording.trajectory

No ROS is needed. A trajectory ends at the end of its episode or of the coordinator's epoch, at a missing decision, and
at a policy change; its last step still has its reward and next decision.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_bags.format import fields_of
from numpy.typing import NDArray

from ctrl_rl_bags import bag_info, read_messages
from option_coordinator.data.trajectory import OptionTrajectory
from option_coordinator.errors import OptionError
from option_coordinator.options.options import NONE, Agent, Mask, Observation, option_mask

TYPE = "ctrl_rl_msgs/msg/JointOptionStep"
_NAMED = 6
"""Largest number of robots named in an error."""


class TeamLayout(NamedTuple):
    """Names, option counts and observation sizes of a recorded team.

    Attributes:
        names: Names of the robots, in the policy's order.
        option_counts: Number of options of each robot.
        observation_sizes: Length of each robot's observation.
    """

    names: tuple[str, ...]
    option_counts: tuple[int, ...]
    observation_sizes: tuple[int, ...]

    @classmethod
    def of(cls, agents: Sequence[Agent]) -> TeamLayout:
        """Create the layout of these robots."""
        rows = [(agent.name, len(agent.options), agent.observation_size) for agent in agents]
        return cls(*zip(*rows, strict=True))

    def check_against(self, wanted: TeamLayout, where: object) -> None:
        """Compare this recorded team with the one that a policy or task is for.

        Raises:
            OptionError: They differ; the message starts with `where` and names the first difference.
        """
        if self.names != wanted.names:
            found, needed = _listed(self.names), _listed(wanted.names)
            raise OptionError(f"{where}: was recorded by another team, of {found}: decisions of {needed} are needed")
        for name, options, size, own, needs in zip(*self, *wanted[1:], strict=True):
            if (options, size) != (own, needs):
                words = f"robot '{name}' has {options} options and observes {size} numbers, not {own} and {needs}"
                raise OptionError(f"{where}: was recorded by another team: its {words}")


def _listed(names: Sequence[str]) -> str:
    """Return the first robots of a team, and the number of others."""
    rest = f" and {len(names) - _NAMED} others" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + rest


@dataclass(frozen=True, eq=False)
class Recording:
    """Consecutive decisions of one policy.

    Attributes:
        team: Team of the decisions.
        digest: SHA-256 (hex) of the policy's file; empty for a scripted policy, or if the policy failed.
        trajectory: Consecutive option steps of one episode.
    """

    team: TeamLayout
    digest: str
    trajectory: OptionTrajectory


def recordings(bag: Path) -> list[Recording]:
    """Read a bag's recordings, in order for each coordinator's epoch.

    Raises:
        BagError: The bag cannot be read.
        OptionError: The bag has no decisions, or an invalid one.
    """
    topics = [name for name, topic in bag_info(bag).topics.items() if topic.type == TYPE]
    if not topics:
        raise OptionError(f"{bag}: holds no topic of {TYPE}: record joint_option_step too")
    # Ordered by number, not by arrival, because two coordinators may briefly decide at the same time.
    lives: dict[tuple[str, int], dict[int, _Step]] = {}
    for message in read_messages(bag, topics):
        with fields_of(f"{bag}: a message of {message.topic}"):
            life = lives.setdefault((message.topic, int(message.data.coordinator_epoch)), {})
            life[int(message.data.step)] = _step(message.data, f"{bag}: {message.topic}: decision {message.data.step}")
    found = [recording for life in lives.values() for recording in _parts([step for _, step in sorted(life.items())])]
    if not found:
        raise OptionError(f"{bag}: no decision has a successor, so their outcomes are unknown")
    return found


@dataclass(frozen=True, eq=False)
class _Step:
    """A message in the form that `OptionTrajectory.of` expects."""

    number: int
    team: TeamLayout
    digest: str
    observation: Observation
    options: NDArray[np.int64]
    choosing: Mask
    running: NDArray[np.int64]
    present: Mask
    legal: Mask
    log_prob: float
    reward: float
    duration: int
    discount: float
    terminated: bool
    over: bool


def _parts(steps: Sequence[_Step]) -> Iterator[Recording]:
    """Yield the recordings of one coordinator epoch."""
    part: list[tuple[_Step, _Step]] = []
    for before, after in pairwise(steps):
        if before.over or after.number != before.number + 1 or after.team != before.team:
            continue
        if part and (part[-1][1] is not before or part[-1][0].digest != before.digest):
            yield _recording(part)
            part = []
        part.append((before, after))
    if part:
        yield _recording(part)


def _recording(part: Sequence[tuple[_Step, _Step]]) -> Recording:
    first, _ = part[0]
    steps = [(before, before.options, before.log_prob, after) for before, after in part]
    return Recording(first.team, first.digest, OptionTrajectory.of(steps))


def _step(message: Any, where: str) -> _Step:
    """Parse and validate a message.

    Raises:
        OptionError: The message is invalid; the error starts with `where`.
    """
    names, counts = tuple(message.agents), tuple(int(count) for count in message.option_counts)
    sizes = tuple(int(size) for size in message.observation_sizes)
    options = np.asarray(message.options, dtype=np.int64)
    running, absent = np.asarray(message.running, dtype=bool), np.asarray(message.absent, dtype=bool)
    observation, flags = np.asarray(message.observations, dtype=np.float32), np.asarray(message.legal, dtype=bool)
    agents = len(names)
    if agents == 0 or {len(counts), len(sizes), len(options), len(running), len(absent)} != {agents}:
        raise OptionError(f"{where}: its arrays are not all for {agents} robots")
    if (len(flags), len(observation)) != (sum(counts), sum(sizes)):
        raise OptionError(f"{where}: legal and observations are not as long as the robots' own together")
    over = bool(message.terminated or message.truncated)
    has_none = absent if not over else ~running
    if np.any((options < 0) != has_none) or np.any(options >= counts) or np.any(running & absent):
        raise OptionError(f"{where}: options {options.tolist()} do not match the robots that are present")
    legal = np.zeros((agents, max(counts)), dtype=bool)
    legal[option_mask(counts)] = flags
    chooses = np.flatnonzero(~running & (options >= 0))
    if not legal[chooses, options[chooses]].all():
        raise OptionError(f"{where}: an option was chosen that was not legal")
    numbers = (message.log_probability, message.reward, *observation)
    if not np.isfinite(numbers).all() or not 0.0 < message.discount <= 1.0:
        raise OptionError(f"{where}: not all its numbers are finite, or its discount {message.discount:g} is none")
    return _Step(
        number=int(message.step),
        team=TeamLayout(names, counts, sizes),
        digest=str(message.policy_digest),
        observation=observation,
        options=options,
        choosing=~running & ~absent,
        running=np.where(running, options, NONE),
        present=~absent,
        legal=legal,
        log_prob=float(message.log_probability),
        reward=float(message.reward),
        duration=int(message.duration),
        discount=float(message.discount) ** int(message.duration),
        terminated=bool(message.terminated),
        over=over,
    )
