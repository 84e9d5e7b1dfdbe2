"""Relabelling of recorded bags with time-to-reach rewards, for offline learning."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_bags.format import BagTypes, fields_of
from ctrl_rl_bags.recording import register

from ctrl_rl_bags import (
    BagError,
    SerializedMessage,
    Topic,
    bag_info,
    copy_bag,
    message_definition,
    open_bag,
    to_bag_qos,
)
from ctrl_rl_core import RESULT, OdometryError, OdometryHealth, OdometryReader, ValueFunction, read_odometry
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.rewards.rewards import RewardEvaluator

REWARD, VALUE = "ctrl_rl_msgs/msg/TaskReward", "ctrl_rl_msgs/msg/StateValue"
_ODOMETRY = "nav_msgs/msg/Odometry"


def relabel(
    bag: Path,
    output: Path,
    function: ValueFunction,
    evaluator: RewardEvaluator,
    *,
    robot: str = "",
    odometry: str = "odom",
    frame: str = "map",
    replace: bool = False,
    progress: bool = False,
) -> int:
    """Copy a bag and add the topics `reward` and `time_to_reach`, one message each per odometry message.

    Type hash and quality of service of the topics are those of the reward node.

    Args:
        bag: Bag with odometry in the frame of the value function.
        output: Folder of the new bag, which must not exist.
        function: Time-to-reach function of the task.
        evaluator: Evaluator of the reward of a state.
        robot: Namespace of the topics; empty for none.
        odometry: Odometry topic, relative to the namespace unless it begins with /.
        frame: Frame of the function's positions, and of the written values and rewards, as in the node.
        replace: Whether to omit rewards and values that the bag already has.
        progress: Whether to show a progress bar on a terminal.

    Returns:
        Number of labelled odometry messages.

    Raises:
        TimeToReachError: The bag has no odometry, or it has rewards and `replace` is false.
        BagError: The bag cannot be read, or the output exists.
    """
    prefix = f"/{robot.strip('/')}" if robot else ""
    odom = odometry if odometry.startswith("/") else f"{prefix}/{odometry}"
    topics = bag_info(bag).topics
    if odom not in topics or topics[odom].type != _ODOMETRY:
        others = [name for name, topic in sorted(topics.items()) if topic.type == _ODOMETRY]
        hint = f"; name it by --odometry {others[0]}" if others else ""
        raise TimeToReachError(f"{bag}: no topic {odom} of type {_ODOMETRY}; it has {', '.join(sorted(topics))}{hint}")
    kinds = {f"{prefix}/reward": REWARD, f"{prefix}/time_to_reach": VALUE}
    there = topics.keys() & kinds
    if there and not replace:
        raise TimeToReachError(f"{bag} already has a topic {min(there)}: add --replace to replace it")
    with open_bag(bag) as opened:
        types = opened.types([odom])
        store = types.store
        answer = _MessageRelabeller(types, f"{bag}: a message of {odom}", odom, prefix, frame, function, evaluator)
        added = [
            Topic(name, kind, message_definition(kind), store.hash_rihs01(kind), (to_bag_qos(RESULT),))
            for name, kind in kinds.items()
        ]
        digests = {"digest.time_to_reach": function.digest}
        title = "relabelling" if progress else ""
        return copy_bag(bag, output, added, answer, left_out=there, custom_data=digests, progress=title) // len(added)


class _MessageRelabeller:
    """Returns a serialized reward and value for each odometry message of a bag."""

    def __init__(
        self,
        known: BagTypes,
        what: str,
        odom: str,
        prefix: str,
        frame: str,
        function: ValueFunction,
        evaluator: RewardEvaluator,
    ) -> None:
        store = known.store
        self._known, self._what = known, what
        self._store, self._odom, self._prefix, self._frame = store, odom, prefix, frame
        self._function, self._evaluate = function, evaluator
        self._read, self._health = OdometryReader(function.state_names), OdometryHealth()
        register(store, REWARD, VALUE)

    def __call__(self, message: SerializedMessage) -> Iterator[tuple[str, bytes]]:
        if message.topic != self._odom:
            return
        try:
            odometry: Any = self._known.decode(message.data, _ODOMETRY)
        except BagError as error:
            raise BagError(f"{self._what} cannot be decoded: {error}") from None
        with fields_of(self._what):
            try:
                numbers, stamp = read_odometry(odometry), odometry.header.stamp
                fault = self._health.update(stamp.sec * 10**9 + stamp.nanosec, numbers)
                if fault and self._read.uses_twist:
                    raise OdometryError(fault)
                state = self._read(numbers)
            except OdometryError as error:
                raise BagError(f"{self._what}: {error}") from None
            header = dataclasses.replace(odometry.header, frame_id=self._frame)
        value, gradient = self._function.value_and_gradient_at(state)
        outcome, reward = self._evaluate(state, value)
        types = self._store.types
        out = types["ctrl_rl_msgs/msg/TaskOutcome"](value=int(outcome))
        yield self._serialized("reward", types[REWARD](header, out, reward, value), REWARD)
        in_domain = not np.isnan(value)
        yield self._serialized("time_to_reach", types[VALUE](header, state, value, gradient, in_domain), VALUE)

    def _serialized(self, topic: str, message: Any, kind: str) -> tuple[str, bytes]:
        return f"{self._prefix}/{topic}", bytes(self._store.serialize_cdr(message, kind))
