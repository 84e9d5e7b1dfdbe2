"""What policies that are learnt from bags observe."""

from __future__ import annotations

from ctrl_rl_core import NavigationTask, PolicyManifest, interface_of


def sensed_interface(task: NavigationTask) -> PolicyManifest:
    """Return the interface of a task's policies, without the pose in a corridor.

    Nothing in a corridor tells a robot where it is on the map: a bag's poses are for the value function alone, and the
    policy drives by its scans and speeds.
    """
    interface = interface_of(task)
    if task.corridor is None:
        return interface
    sensed = [part for part in interface.observation if part.source != "pose"]
    return interface.model_copy(update={"observation": sensed})
