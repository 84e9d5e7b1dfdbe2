"""The file of a joint policy: tensors in safetensors format, and a manifest that names the agents.

policy = OptionPolicy.load(Path("policy.safetensors"))
choices = policy.choose(decision, generator)
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from ctrl_rl_core.io import Anything, Name, Schema, encode_tensors, one_line, raise_as, read_tensors, short_path
from pydantic import Field

from ctrl_rl_core import atomic_write
from option_coordinator.errors import OptionError
from option_coordinator.options.options import NONE, Agent, Decision
from option_coordinator.policies.joint_policy import JointPolicy
from option_coordinator.policies.network import Autoregressive, JointTable, Mixture, Tensors, part
from option_coordinator.policies.partial import Partial, Presence

FORMAT = "option-policy-1"


class _Agent(Schema):
    """A robot in the header."""

    name: Name
    options: Annotated[list[Name], Field(min_length=1, max_length=1000)]
    observation_size: Annotated[int, Field(ge=1, le=1_000_000)]


class _Header(Schema):
    """Header of the file, with the fields of `OptionPolicy`."""

    format: Literal["option-policy-1"]
    agents: Annotated[list[_Agent], Field(min_length=1, max_length=1000)]
    head: Literal["table", "mixture", "autoregressive"]
    partial: bool
    presence: bool = False
    greedy: bool
    manifest: Anything


_HEADER_KEY = "option_policy"

HEADS: Mapping[str, Callable[[Tensors, tuple[int, ...]], JointPolicy]] = {
    "table": JointTable,
    "mixture": Mixture,
    "autoregressive": Autoregressive,
}
"""Kinds of joint policy by name."""
MOST_CELLS = 50_000
"""Maximum size of a joint table; a minibatch of larger ones takes hundreds of MB."""


def check_size(head: str, counts: Sequence[int]) -> None:
    """Raise if a kind of joint policy is too large for agents with these numbers of options.

    Raises:
        OptionError: A joint table would have too many cells.
    """
    if head == "table" and math.prod(counts) > MOST_CELLS:
        raise OptionError(
            f"a joint table of {len(counts)} robots has {math.prod(counts):.3g} cells, more than {MOST_CELLS}: use the "
            "mixture of products instead, --methods async_mixture or --head mixture"
        )


def shipped_policies() -> dict[str, Path]:
    """Return the shipped policies by team name."""
    return {file.stem: file for file in sorted((Path(__file__).parent / "pretrained").glob("*.safetensors"))}


def policy_file(name_or_path: Path | str) -> Path:
    """Return the file of a shipped policy, or the path unchanged.

    Raises:
        OptionError: The policy does not exist.
    """
    shipped = shipped_policies()
    path = shipped.get(str(name_or_path), Path(name_or_path).expanduser())
    try:
        there, why = path.exists(), f"there are {', '.join(shipped) or 'none'}, or give a file"
    except (OSError, ValueError) as error:
        there, why = False, one_line(error, 100)
    if not there:
        raise OptionError(f"no policy '{short_path(name_or_path)}': {why}")
    return path


def make_policy(
    head: str, tensors: Tensors, counts: tuple[int, ...], partial: bool, presence: bool = False
) -> JointPolicy:
    """Create a joint policy from its tensors; those of a partial policy start with "0.", "1." etc.

    Raises:
        OptionError: The kind is unknown, or a tensor is missing.
    """
    if head not in HEADS:
        raise OptionError(f"no kind of joint policy '{head}': there are {', '.join(HEADS)}")
    if partial and presence:
        raise OptionError("a partially centralised policy does not observe presence: create it without presence")
    try:
        if partial:
            return Partial([HEADS[head](part(tensors, f"{i}."), counts) for i in range(len(counts))])
        policy = HEADS[head](tensors, counts)
        return Presence(policy) if presence else policy
    except KeyError as error:
        raise OptionError(f"joint policy '{head}': tensor {error} is missing") from None


@dataclass(frozen=True, eq=False)
class OptionPolicy:
    """A joint policy with its agents, tensors and manifest.

    Attributes:
        agents: Agents whose options are chosen, in the policy's order.
        head: Kind of joint policy, a key of `HEADS`.
        partial: Whether each agent has its own policy (Eq. 5.5).
        tensors: Tensors of the policy's networks, by name.
        presence: Whether the network also observes which agents are present, see `Presence`.
        greedy: Whether to use the most likely options rather than samples.
        manifest: Task, digest, method and results, as JSON values.
    """

    agents: tuple[Agent, ...]
    head: str
    partial: bool
    tensors: Tensors
    presence: bool = False
    greedy: bool = False
    manifest: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def joint(self) -> JointPolicy:
        """The joint policy."""
        counts = tuple(len(agent.options) for agent in self.agents)
        policy = make_policy(self.head, self.tensors, counts, self.partial, self.presence)
        size = sum(agent.observation_size for agent in self.agents)
        if policy.observation_size != size:
            raise OptionError(f"the policy observes {policy.observation_size} numbers, its agents {size}")
        return policy

    def choose(self, decision: Decision, generator: np.random.Generator) -> dict[str, int]:
        """Return an option for each ready agent: a sample, or the most likely one if `greedy`."""
        return decision.named(self.joint.choose(decision, None if self.greedy else generator)[0])

    @cached_property
    def digest(self) -> str:
        """SHA-256 (hex) of the policy's file, or of the file that `save` would write."""
        return hashlib.sha256(self._content()).hexdigest()

    def save(self, path: Path) -> None:
        """Write the policy atomically."""
        atomic_write(path, self._content())

    def _content(self) -> bytes:
        agents = [vars(agent) for agent in self.agents]
        kind = {name: getattr(self, name) for name in ("head", "partial", "presence", "greedy")}
        header = {"format": FORMAT, "agents": agents, **kind, "manifest": dict(self.manifest)}
        return encode_tensors(self.tensors, _HEADER_KEY, header)

    @classmethod
    def load_for(cls, path: Path | str, agents: Iterable[Agent]) -> Self:
        """Load the policy of a team.

        Raises:
            OptionError: As for `load`, or the policy belongs to another team.
        """
        policy = cls.load(path)
        if policy.agents != tuple(agents):
            others = ", ".join(agent.name for agent in policy.agents)
            raise OptionError(f"{short_path(path)}: is a policy of other robots or options: {others}")
        return policy

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Load a shipped policy by name, or a file.

        Raises:
            OptionError: The file is missing or not a joint policy; the message names it.
        """
        file = policy_file(path)
        with raise_as(OptionError, file):
            header, tensors, digest = read_tensors(file, _HEADER_KEY, with_digest=True)
            told = _Header.model_validate(header)
            agents = tuple(Agent(agent.name, tuple(agent.options), agent.observation_size) for agent in told.agents)
            rest = told.model_dump(exclude={"format", "agents"})
            policy = cls(agents=agents, tensors=tensors, **rest)
            policy.__dict__["digest"] = digest  # digest of the content read, independent of the writer
            policy.check()
        return policy

    def check(self) -> None:
        """Check that the policy is complete.

        Raises:
            OptionError: A tensor is missing or has the wrong size.
        """
        everyone = np.ones(len(self.agents), dtype=bool)
        try:
            # For autoregressive policies too: every path through the network must have tensors of the right sizes.
            for choosing in (everyone, *(everyone & (np.arange(len(everyone)) == i) for i in range(len(everyone)))):
                given = self.joint.given(np.zeros(self.joint.observation_size), choosing, np.where(choosing, NONE, 0))
                given.log_prob(given.sample(np.random.default_rng(0)))
        except (ValueError, IndexError, KeyError) as error:
            raise OptionError(f"its tensors do not match each other or its options ({error}): learn it again") from None
