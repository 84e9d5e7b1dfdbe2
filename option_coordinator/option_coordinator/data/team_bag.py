"""Writes bags of decisions without a ROS graph, with the messages that a coordinator would publish.

with TeamBag(folder, environment.discount) as bag:
    bag.put(decision, options, log_prob)
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

import numpy as np
from ctrl_rl_bags.recording import typestore
from numpy.typing import NDArray

from ctrl_rl_bags import BagWriter, Topic, message_definition
from option_coordinator.data.bag_trajectory import TYPE
from option_coordinator.options.options import Decision

TOPIC = "/joint_option_step"
_BEGIN_NS, _SECOND_NS = 10**12, 10**9


class TeamBag:
    """Writes a bag one decision at a time; a context manager.

    Args:
        folder: Folder of the bag, which must not exist.
        discount: Discount factor gamma of a low-level step.
        time_step: Duration of a low-level step [s].

    Raises:
        BagError: The bag exists, or writing fails.
    """

    def __init__(self, folder: Path, discount: float, time_step: float = 1.0) -> None:
        self._discount, self._time_step = discount, time_step
        self._store = typestore(TYPE)
        self._writer = BagWriter(folder)
        self._writer.add_topic(Topic(TOPIC, TYPE, message_definition(TYPE), self._store.hash_rihs01(TYPE), ()))
        self._time, self._number = _BEGIN_NS, 0

    def put(self, decision: Decision, options: NDArray[np.int64], log_prob: float = 0.0, digest: str = "") -> None:
        """Append a decision; at the end of an episode, `options` are those still running.

        Args:
            decision: Decision of a coordinator or an environment.
            options: Joint option (N,).
            log_prob: Log-probability of the chosen options; 0 for a scripted policy.
            digest: SHA-256 of the policy's file, hex; empty for a scripted policy.

        Raises:
            BagError: Writing fails.
        """
        self.write(self.fields(decision, options, log_prob, digest))

    def fields(self, decision: Decision, options: NDArray[np.int64], log_prob: float, digest: str) -> dict[str, Any]:
        """Return the fields of a decision message, except the header."""
        counts = [len(agent.options) for agent in decision.agents]
        return {
            "coordinator_epoch": 1,
            "step": self._number,
            "policy_digest": digest,
            "agents": [agent.name for agent in decision.agents],
            "running": decision.running >= 0,
            "absent": ~decision.present,
            "options": np.asarray(options, np.int32),
            "legal": np.concatenate([row[:count] for row, count in zip(decision.legal, counts, strict=True)]),
            "option_counts": np.array(counts, np.uint32),
            "observations": decision.observation,
            "observation_sizes": np.array([agent.observation_size for agent in decision.agents], np.uint32),
            "log_probability": log_prob,
            "reward": decision.reward,
            "duration": decision.duration,
            "discount": self._discount,
            "time_step": self._time_step,
            "terminated": decision.terminated,
            "truncated": decision.truncated,
        }

    def write(self, fields: dict[str, Any]) -> None:
        """Append a message with these fields.

        Raises:
            BagError: Writing fails.
        """
        types = self._store.types
        self._time += max(round(fields["duration"] * self._time_step * _SECOND_NS), 1)  # stamps must be distinct
        stamp = types["builtin_interfaces/msg/Time"](*divmod(self._time, _SECOND_NS))
        message = types[TYPE](header=types["std_msgs/msg/Header"](stamp, ""), **fields)
        self._writer.write(TOPIC, bytes(self._store.serialize_cdr(message, TYPE)), self._time)
        self._number += 1

    def close(self) -> None:
        """Finish the bag; further calls do nothing."""
        self._writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
