"""The interface of a policy that also observes how it moves, and the policy to fine-tune, from its file."""

from __future__ import annotations

import numpy as np

from ctrl_rl_core import Actor, PolicyManifest, find_policy
from ctrl_rl_learning.errors import LearningError
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
    actor = Actor.load(find_policy(name))
    if actor.interface is None:
        raise LearningError(f"{name} does not say what it observes: write it anew with `export` of its package")
    if motion and not actor.interface.observes("command"):
        interface = with_motion(actor.interface)
        span = 0.5 * (actor.high - actor.low)
        actor = widen(actor, interface, np.concatenate((span, span)))
    assert actor.interface is not None
    return actor, actor.interface
