"""Actors as policies of a node: `policy.safetensors` of a training run, and those shipped with this package."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.networks.layers import Clip, Dense, Layer, Network, Normalise, Pointwise, Scale
from ctrl_rl_core.policies.actor import Actor
from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.policies.manifest import PolicyManifest
from ctrl_rl_core.policies.policy import NetworkPolicy, PolicyDescription, PolicyKind
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
    manifest = _interface(actor)

    def network(observation: NDArray[np.float32]) -> NDArray[np.float32]:
        return actor.scaled_action((observation - actor.middle) / actor.unit)

    told = [str(actor.manifest[key]) for key in ("task", "algorithm", "reward", "method") if key in actor.manifest]
    return NetworkPolicy(manifest, network, ", ".join(told) or "an actor")


def describe_actor(path: Path) -> PolicyDescription:
    """Describe the policy of an actor file for export.

    Raises:
        PolicyError: As for `load_actor_policy`.
    """
    actor = Actor.load(path)
    policy = policy_of(actor)
    return PolicyDescription(
        network=Network(len(actor.middle), (), {"action": tuple(_layers(actor))}),
        outputs=lambda sensors: {"action": policy.command(sensors)},
        training=actor.manifest,
        manifest=_interface(actor),
    )


def _layers(actor: Actor) -> Iterator[Layer]:
    """Yield the layers of an actor, from the observation to actions in [-1, 1]."""
    yield Scale(actor.middle, actor.unit)
    kind = actor.activation.removeprefix("normalized_")
    for index, (W, b) in enumerate(zip(actor.weights, actor.biases, strict=True)):
        yield Dense(W, b)
        if index == len(actor.weights) - 1:
            break
        if kind != actor.activation:
            yield Normalise(np.ones(len(b), np.float32), np.zeros(len(b), np.float32))
        yield Pointwise("tanh" if kind == "tanh" else "relu")
    yield Pointwise("tanh") if actor.squashed else Clip(-1.0, 1.0)


def shipped_actors() -> dict[str, Path]:
    """Return the actors shipped with this package, by name."""
    folder = Path(str(files("ctrl_rl_core"))) / "policies" / "pretrained"
    return {file.stem: file for file in sorted(folder.glob("*.safetensors"))}


def _interface(actor: Actor) -> PolicyManifest:
    """Return the interface of an actor; if its file does not include one, that of its task, if the task is known."""
    if actor.interface is not None:
        return actor.interface
    name = str(actor.manifest.get("task"))
    if name in task_names():
        task = load_navigation_task(name)
        if task_digest(task) == actor.manifest.get("task_digest"):
            return interface_of(task)
    raise PolicyError(
        "does not describe its observation: write it again with `ros2 run ctrl_rl_learning export --task FILE`"
    )


KIND = PolicyKind(load_actor_policy, shipped_actors, describe_actor)
