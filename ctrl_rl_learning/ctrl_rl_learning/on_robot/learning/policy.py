"""The policy to fine-tune, from its file."""

from __future__ import annotations

import numpy as np

from ctrl_rl_core import Actor, PolicyManifest, find_policy
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.on_robot.environment.interface import with_motion
from ctrl_rl_learning.torch.networks import widen


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
