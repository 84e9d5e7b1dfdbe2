"""The interface of a policy that also observes how it moves, and the policy to fine-tune, from a file of any kind."""

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
    """Return the interface with speed, turn rate and the last command after the other observations.

    A command that takes effect only after the next decision, or through slow motors, is a part of the robot's state:
    a policy that does not know it cannot tell what its next command will do.
    """
    content = interface.model_dump(exclude_defaults=True)
    content["observation"] = [*content["observation"], *_MOTION]
    return PolicyManifest.model_validate(content)


def read_policy(name: str, motion: bool) -> tuple[Actor, PolicyManifest]:
    """Return a policy to fine-tune and its interface.

    Args:
        name: Name of a shipped policy, or a file.
        motion: Whether it is to observe its speeds and its last command, too.

    Raises:
        PolicyError, LearningError: There is no such policy, or it does not say what it observes.
    """
    return _with_interface(Actor.load(find_policy(name)), name, motion)


def read_or_clone(
    name: str, motion: bool, task: NavigationTask, seed: int, folder: Path, tell: Callable[[str], object] = print
) -> tuple[Actor, PolicyManifest]:
    """Return a policy to fine-tune and its interface; one of another kind than a network's is cloned.

    Args:
        name: Name of a shipped policy, or a file: of a Koopman policy or an ONNX model, too.
        motion: Whether it is to observe its speeds and its last command, too.
        task: Task in whose simulator it is cloned.
        seed: Seed of the clone.
        folder: Folder in which the clone is kept.
        tell: Takes lines about the clone.

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
        raise LearningError(f"{name} does not say what it observes: write it anew with `export` of its package")
    if motion and not actor.interface.observes("command"):
        interface = with_motion(actor.interface)
        span = 0.5 * (actor.high - actor.low)
        actor = widen(actor, interface, np.concatenate((span, span)))
    assert actor.interface is not None
    return actor, actor.interface
