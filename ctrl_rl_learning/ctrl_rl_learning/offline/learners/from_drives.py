"""A policy from recorded drives, in one call: `learn_offline` of the front door."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from ctrl_rl_core import Actor, ValueFunction
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.data.transitions import RecordedDrives
from ctrl_rl_learning.offline.data.values import TIME_TO_REACH, StateValues, clearance_of, load_values
from ctrl_rl_learning.offline.learners.learning import learn
from ctrl_rl_learning.offline.learners.settings import METHODS, NEEDS_VALUE, LearningSettings


def learn_from_drives(
    data: RecordedDrives,
    method: str = "value_model",
    *,
    value: ValueFunction | None = None,
    updates: int = 5000,
    seed: int = 0,
) -> Actor:
    """Learn a policy from recorded drives alone; its `save` writes a file for the node `policy`.

    >>> import ctrl_rl, tempfile, pathlib
    >>> from ctrl_rl_learning.offline import ScriptedDriver, drive      # records without ROS
    >>> task = ctrl_rl.load_task("car_navigation")
    >>> bag = pathlib.Path(tempfile.mkdtemp()) / "bag"
    >>> _ = drive(task, ScriptedDriver(task), episodes=3, seed=0, bag=bag)
    >>> policy = ctrl_rl.learn_offline(ctrl_rl.transitions([bag], task), "bc", updates=20)
    >>> policy.manifest["method"]
    'bc'

    Args:
        data: Drives that `ctrl_rl.transitions` has read.
        method: One of `ctrl_rl_learning.offline.learners.settings.METHODS`: value_model (the default), value_weight and
            value_critic learn from a value function; td3bc, iql and cql from rewards in the bags; bc clones.
        value: Value function of the task, for the methods that need one; its time to reach by what the robot can do,
            with room of half its radius to obstacles, is solved here unless given.
        updates: Number of updates of the networks.
        seed: Seed of weights and batches.

    Raises:
        LearningError: There is no such method, or the bags do not hold what it needs.
        CtrlRlError: The value function does not fit the task.
    """
    if method not in METHODS:
        raise LearningError(f"no method '{method}': there are {', '.join(METHODS)}")
    values = None if value is None else StateValues(value, data.task)
    if values is None and method in NEEDS_VALUE:
        with TemporaryDirectory() as folder:
            values = load_values(TIME_TO_REACH, data.task, Path(folder), clearance_of(data.task, None))
    settings = LearningSettings(method, updates, seed=seed)
    return learn(data.transitions, data.task, settings, values, {"bags": list(data.bags)})
