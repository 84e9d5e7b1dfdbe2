"""The interface of a policy that also observes how it moves: what a delayed or sluggish robot needs to be told."""

from __future__ import annotations

from ctrl_rl_core import PolicyManifest

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
