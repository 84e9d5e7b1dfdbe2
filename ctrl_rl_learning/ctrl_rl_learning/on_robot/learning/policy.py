"""Load the policy to fine-tune from a file of any kind, and add the robot's motion to its observation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from ctrl_rl_core.policies import policy_digest
from tqdm import tqdm

from ctrl_rl_core import (
    Actor,
    NavigationTask,
    PolicyError,
    PolicyManifest,
    find_policy,
    load_policy,
    task_digest,
)
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.on_robot.learning.clone import EPISODES, ROUNDS, clone
from ctrl_rl_learning.torch.networks import widen

_MOTION = (
    {"source": "odometry", "names": ["v", "omega"], "low": -20.0, "high": 20.0},
    {"source": "command", "names": ["v", "omega"]},
)


def with_motion(interface: PolicyManifest) -> PolicyManifest:
    """Return the interface with speed, turn rate and the last command appended to the observation.

    With a delay longer than one decision, or with slow motors, the last command is part of the robot's state: a policy
    that does not observe it cannot predict the effect of its next command.
    """
    content = interface.model_dump(exclude_defaults=True)
    content["observation"] = [*content["observation"], *_MOTION]
    return PolicyManifest.model_validate(content)


def read_policy(name: str, motion: bool) -> tuple[Actor, PolicyManifest]:
    """Return a policy to fine-tune and its interface.

    Args:
        name: Name of a shipped policy, or a file.
        motion: Whether to add speeds and last command to its observation.

    Raises:
        PolicyError, LearningError: There is no such policy, or its file does not describe its observation.
    """
    return _with_interface(Actor.load(find_policy(name)), name, motion)


def read_or_clone(
    name: str, motion: bool, task: NavigationTask, seed: int, folder: Path, tell: Callable[[str], object] = print
) -> tuple[Actor, PolicyManifest]:
    """Return a policy to fine-tune and its interface; clone it first if it is not a trainable network.

    Args:
        name: Name of a shipped policy, or a file, including Koopman policies and ONNX models.
        motion: Whether to add speeds and last command to its observation.
        task: Task in whose simulator the policy is cloned.
        seed: Seed of the clone.
        folder: Folder to write the clone to.
        tell: Callback for progress lines about the clone.

    Raises:
        PolicyError, LearningError: There is no such policy, or it cannot be cloned.
    """
    path = find_policy(name)
    try:
        return _with_interface(Actor.load(path), name, motion)
    except PolicyError:
        policy = load_policy(path)
    kept = folder / "cloned.safetensors"
    terms = {"cloned_from": policy_digest(path), "task_digest": task_digest(task), "seed": seed}
    actor = Actor.load(kept) if kept.exists() else None
    if actor is None or any(actor.manifest.get(key) != value for key, value in terms.items()):
        with tqdm(total=ROUNDS * EPISODES, desc="cloning", unit="episode", disable=None) as bar:
            found = clone(policy, task, seed, bar.update)
        tell(
            f"clone      {found.scans} scans in the simulator; {found.arrived} of {EPISODES} drives of its own arrive, "
            f"its commands differ by {found.error[0]:.3f} m/s and {found.error[1]:.3f} rad/s from the policy's"
        )
        actor = replace(found.actor, manifest={**found.actor.manifest, **terms})
        folder.mkdir(parents=True, exist_ok=True)
        actor.save(kept)
    return _with_interface(actor, name, motion)


def _with_interface(actor: Actor, name: str, motion: bool) -> tuple[Actor, PolicyManifest]:
    if actor.interface is None:
        raise LearningError(
            f"{name} does not describe its observation: write it again with `ros2 run ctrl_rl_learning export`"
        )
    if motion and not actor.interface.observes("command"):
        interface = with_motion(actor.interface)
        span = 0.5 * (actor.high - actor.low)
        actor = widen(actor, interface, np.concatenate((span, span)))
    assert actor.interface is not None
    return actor, actor.interface
