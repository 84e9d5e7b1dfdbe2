"""Actors as policies of a node: `policy.safetensors` of a training run, and those shipped with this package."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.policies.actor import Actor
from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.policies.manifest import PolicyManifest
from ctrl_rl_core.policies.policy import NetworkPolicy, PolicyKind
from ctrl_rl_core.policies.task_interface import interface_of
from ctrl_rl_core.tasks.task import load_navigation_task, task_digest, task_names


def load_actor_policy(path: Path) -> NetworkPolicy:
    """Load the policy of an actor file.

    Raises:
        PolicyError: The file is not an actor, or does not describe its observation.
    """
    return policy_of(Actor.load(path))


def policy_of(actor: Actor) -> NetworkPolicy:
    """Wrap an actor as a policy that drives a robot.

    Raises:
        PolicyError: The actor does not describe its observation.
    """
    manifest = actor.interface or _known_interface(actor)

    def network(observation: NDArray[np.float32]) -> NDArray[np.float32]:
        return actor.scaled_action((observation - actor.middle) / actor.unit)

    told = [str(actor.manifest[key]) for key in ("task", "algorithm", "reward", "method") if key in actor.manifest]
    return NetworkPolicy(manifest, network, ", ".join(told) or "an actor")


def shipped_actors() -> dict[str, Path]:
    """Return the actors shipped with this package, by name."""
    folder = Path(str(files("ctrl_rl_core"))) / "policies" / "pretrained"
    return {file.stem: file for file in sorted(folder.glob("*.safetensors"))}


def _known_interface(actor: Actor) -> PolicyManifest:
    """Return the interface of an actor that does not include one: that of its task, if the task is known."""
    name = str(actor.manifest.get("task"))
    if name in task_names():
        task = load_navigation_task(name)
        if task_digest(task) == actor.manifest.get("task_digest"):
            return interface_of(task)
    raise PolicyError("does not describe its observation: write it again with `export --task FILE` of its package")


KIND = PolicyKind(load_actor_policy, shipped_actors)
