"""The front door: a few names over the whole suite, with and without ROS.

    import ctrl_rl

    task = ctrl_rl.load_task("car_ttr")
    value = ctrl_rl.solve(task)
    policy = ctrl_rl.train(task, "ppo", reward=ctrl_rl.TimeToReach(value), samples=100_000)
    runs = ctrl_rl.drive(task, policy, seeds=range(100), filter="safety")
    policy.save("mine.safetensors")

Gymnasium makes the tasks by name: `gymnasium.make("sim_bridge.environments:ctrl_rl/car_ttr-v0")`, or `make_vec`.

A name is imported when it is first used: a robot without torch, a simulator or ROS can import the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ctrl_rl_safety.trials import drive as drive
    from ttr_reward_node.training import train as train

    from ctrl_rl_core import Box as Box
    from ctrl_rl_core import CtrlRlError as CtrlRlError
    from ctrl_rl_core import Disc as Disc
    from ctrl_rl_core import OccupancyMap as OccupancyMap
    from ctrl_rl_core import load_policy as load_policy
    from ctrl_rl_core import load_task as load_task
    from ctrl_rl_core import make_system as make_system
    from ctrl_rl_learning import learn_from_drives as learn_offline  # noqa: F401
    from ctrl_rl_learning import read_drives as transitions  # noqa: F401
    from ctrl_rl_safety import SafetyShield as SafetyShield
    from ctrl_rl_safety import find_model as find_model
    from ttr_reward_node import TimeToReach as TimeToReach
    from ttr_reward_node import TimeToReachReward as TimeToReachReward
    from ttr_reward_node import TimeToReachVectorReward as TimeToReachVectorReward
    from ttr_reward_node import load_value as load_value
    from ttr_reward_node import solve_value as solve  # noqa: F401

_NAMES = {
    "Box": "ctrl_rl_core:Box",
    "CtrlRlError": "ctrl_rl_core:CtrlRlError",
    "Disc": "ctrl_rl_core:Disc",
    "OccupancyMap": "ctrl_rl_core:OccupancyMap",
    "SafetyShield": "ctrl_rl_safety:SafetyShield",
    "TimeToReach": "ttr_reward_node:TimeToReach",
    "TimeToReachReward": "ttr_reward_node:TimeToReachReward",
    "TimeToReachVectorReward": "ttr_reward_node:TimeToReachVectorReward",
    "drive": "ctrl_rl_safety.trials:drive",
    "find_model": "ctrl_rl_safety:find_model",
    "learn_offline": "ctrl_rl_learning.offline:learn_from_drives",
    "load_policy": "ctrl_rl_core:load_policy",
    "load_task": "ctrl_rl_core:load_task",
    "load_value": "ttr_reward_node:load_value",
    "make_system": "ctrl_rl_core:make_system",
    "solve": "ttr_reward_node:solve_value",
    "train": "ttr_reward_node.training:train",
    "transitions": "ctrl_rl_learning.offline:read_drives",
}
_EXTRAS = {
    "casadi": "mpc",
    "h5py": "datasets",
    "matplotlib": "sim",
    "mujoco": "sim",
    "onnx": "onnx",
    "onnxruntime": "onnx",
    "pyarrow": "datasets",
    "pybullet": "sim",
    "sb3_contrib": "learn",
    "stable_baselines3": "learn",
    "torch": "learn",
}
"""Extra of the installation that has a module."""
__all__ = tuple(_NAMES)


def __getattr__(name: str) -> Any:
    if name not in _NAMES:
        raise AttributeError(f"module 'ctrl_rl' has no attribute '{name}': there are {', '.join(_NAMES)}")
    module, _, attribute = _NAMES[name].partition(":")
    try:
        found = getattr(import_module(module), attribute)
    except ModuleNotFoundError as missing:
        needed = str(missing.name).partition(".")[0]
        if needed not in _EXTRAS:
            raise
        raise ImportError(f"ctrl_rl.{name} needs {needed}: pip install 'ctrl_rl[{_EXTRAS[needed]}]'") from None
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(_NAMES)
