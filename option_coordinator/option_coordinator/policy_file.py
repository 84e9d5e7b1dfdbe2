"""A joint policy's file: tensors in safetensors, and a manifest that says whose options it chooses. No pickles.

policy = OptionPolicy.load(Path("policy.safetensors"))
choices = policy.choose(decision, generator)
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from ctrl_rl_core.whole_file import write_whole
from safetensors import SafetensorError
from safetensors.numpy import load, save

from option_coordinator.autoregressive import Autoregressive
from option_coordinator.decision import NONE, Decision
from option_coordinator.errors import OptionError
from option_coordinator.joint_policy import JointPolicy
from option_coordinator.joint_table import JointTable
from option_coordinator.mixture import Mixture
from option_coordinator.network import Tensors, part
from option_coordinator.options import Agent
from option_coordinator.partial import Partial
from option_coordinator.presence import Presence

FORMAT = "option-policy-1"
_HEADER_KEY = "option_policy"

HEADS: Mapping[str, Callable[[Tensors, tuple[int, ...]], JointPolicy]] = {
    "table": JointTable,
    "mixture": Mixture,
    "autoregressive": Autoregressive,
}
"""Kinds of joint policy by name."""


def shipped_policies() -> dict[str, Path]:
    """Return the policies that come with the package, by name, which is that of their team."""
    return {file.stem: file for file in sorted((Path(__file__).parent / "policies").glob("*.safetensors"))}


def policy_file(name_or_path: Path | str) -> Path:
    """Return the file of a policy that comes with the package, by name, or the path itself.

    Raises:
        OptionError: there is no such policy.
    """
    shipped = shipped_policies()
    path = shipped.get(str(name_or_path), Path(name_or_path))
    if not path.exists():
        raise OptionError(f"no policy '{name_or_path}': there are {', '.join(shipped) or 'none'}, or give a file")
    return path


def make_policy(
    head: str, tensors: Tensors, counts: tuple[int, ...], partial: bool, presence: bool = False
) -> JointPolicy:
    """Return a joint policy from its tensors; those of a partial one are named "0.", "1." and so on.

    Raises:
        OptionError: there is no such kind, or a tensor is missing.
    """
    if head not in HEADS:
        raise OptionError(f"no kind of joint policy '{head}': there are {', '.join(HEADS)}")
    if partial and presence:
        raise OptionError("a partially centralised policy is not told who is there: make it without presence")
    try:
        if partial:
            return Partial([HEADS[head](part(tensors, f"{i}."), counts) for i in range(len(counts))])
        policy = HEADS[head](tensors, counts)
        return Presence(policy) if presence else policy
    except KeyError as error:
        raise OptionError(f"joint policy '{head}': tensor {error} is missing") from None


@dataclass(frozen=True, eq=False)
class OptionPolicy:
    """A joint policy and all that is needed to use it.

    Attributes:
        agents: whose options it chooses, in its order.
        head: kind of joint policy, a key of `HEADS`.
        partial: whether each agent has one of its own (Eq. 5.5).
        tensors: of its networks.
        presence: it is told who is there, see `presence`.
        greedy: it is meant to be used by its mode; else by draws.
        manifest: anything else worth keeping: task, digest, method, figures.
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
        """Return an option for each agent that is ready: a draw, or the most likely ones if it is `greedy`."""
        conditional = self.joint.given(decision.observation, decision.choosing, decision.running, decision.legal)
        return decision.named(conditional.mode() if self.greedy else conditional.sample(generator))

    @cached_property
    def digest(self) -> str:
        """SHA-256 (hex) of its file: of that it was read from, or else of that it would be saved as."""
        return hashlib.sha256(self._content()).hexdigest()

    def save(self, path: Path) -> None:
        """Write it; the file is there whole or not at all."""
        write_whole(path, self._content())

    def _content(self) -> bytes:
        header = {
            "format": FORMAT,
            "agents": [
                {"name": agent.name, "options": agent.options, "observation_size": agent.observation_size}
                for agent in self.agents
            ],
            "head": self.head,
            "partial": self.partial,
            "presence": self.presence,
            "greedy": self.greedy,
            "manifest": dict(self.manifest),
        }
        tensors = {name: np.ascontiguousarray(tensor) for name, tensor in self.tensors.items()}
        return save(tensors, metadata={_HEADER_KEY: json.dumps(header, sort_keys=True)})

    @classmethod
    def load_for(cls, path: Path | str, agents: Iterable[Agent]) -> Self:
        """Read the policy of a team.

        Raises:
            OptionError: as for `load`, or it is of another team.
        """
        policy = cls.load(path)
        if policy.agents != tuple(agents):
            others = ", ".join(agent.name for agent in policy.agents)
            raise OptionError(f"{path}: is a policy of other robots or options: {others}")
        return policy

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read a policy that comes with the package, by name, or a file.

        Raises:
            OptionError: the file is missing or is no such policy; the message names it.
        """
        try:
            content = policy_file(path).read_bytes()
            header = _header(content)
            if header.get("format") != FORMAT:
                raise OptionError(f"{path}: is not a policy of format {FORMAT}: learn it again")
            policy = cls(
                agents=tuple(
                    Agent(agent["name"], tuple(agent["options"]), agent["observation_size"])
                    for agent in header["agents"]
                ),
                head=header["head"],
                partial=header["partial"],
                tensors=load(content),
                presence=header.get("presence", False),
                greedy=header["greedy"],
                manifest=header["manifest"],
            )
        except OSError as error:
            raise OptionError(f"{path}: cannot be read as a policy: {str(error.strerror).lower()}") from None
        except (SafetensorError, ValueError, KeyError, TypeError) as error:
            raise OptionError(f"{path}: is no policy of options as `train` writes them ({error})") from None
        policy.__dict__["digest"] = hashlib.sha256(content).hexdigest()  # of what was read, however it was written
        try:
            policy.check()
        except OptionError as error:
            raise OptionError(f"{path}: {error}") from None
        return policy

    def check(self) -> None:
        """Refuse what cannot choose.

        Raises:
            OptionError: a tensor is missing, of another size or not finite.
        """
        wrong = [name for name, tensor in self.tensors.items() if not np.isfinite(tensor).all()]
        if wrong:
            raise OptionError(f"not all numbers of {', '.join(wrong)} are finite: learn it again")
        everyone = np.ones(len(self.agents), dtype=bool)
        try:
            # Of one agent after the other too: each way through the network must have tensors of the right sizes.
            for choosing in (everyone, *(everyone & (np.arange(len(everyone)) == i) for i in range(len(everyone)))):
                given = self.joint.given(np.zeros(self.joint.observation_size), choosing, np.where(choosing, NONE, 0))
                given.log_prob(given.sample(np.random.default_rng(0)))
        except (ValueError, IndexError, KeyError) as error:
            raise OptionError(f"its tensors do not fit each other or its options ({error}): learn it again") from None


def _header(content: bytes) -> dict[str, Any]:
    """Return what a policy says of itself: safetensors begin with a length of 8 bytes and so much JSON."""
    end = 8 + int.from_bytes(content[:8], "little")
    described: dict[str, Any] = json.loads(json.loads(content[8:end])["__metadata__"][_HEADER_KEY])
    return described
