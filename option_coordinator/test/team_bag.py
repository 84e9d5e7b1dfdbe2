"""Bags of a simulated team, as a coordinator's would be."""

from pathlib import Path

import numpy as np
from option_coordinator.data.bag_trajectory import TYPE
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ctrl_rl_bags import BagWriter, Topic
from option_coordinator import OptionTrajectory

TOPIC = "/joint_option_step"
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(
    get_types_from_msg(
        (Path(__file__).parents[2] / "ctrl_rl_msgs" / "msg" / "JointOptionStep.msg").read_text(encoding="utf-8"), TYPE
    )
)
TIME, HEADER = (STORE.types[f"{name}"] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header"))


class TeamBag:
    """Writes a bag decision by decision; a context manager."""

    def __init__(self, folder):
        self.writer = BagWriter(folder)
        definition, _ = STORE.generate_msgdef(TYPE, ros_version=2)
        self.writer.add_topic(Topic(TOPIC, TYPE, definition, STORE.hash_rihs01(TYPE), ()))
        self.time = 10**12

    def put(self, decision, chosen, log_prob, digest, number, epoch=1, low_level=0.99, **changes):
        """Write a decision; `changes` are made to the message."""
        self.time += 10**9
        sizes = [agent.observation_size for agent in decision.agents]
        counts = [len(agent.options) for agent in decision.agents]
        fields = {
            "header": HEADER(TIME(self.time // 10**9, 0), ""),
            "coordinator_epoch": epoch,
            "step": number,
            "policy_digest": digest,
            "agents": [agent.name for agent in decision.agents],
            "running": decision.running >= 0,
            "absent": ~decision.present,
            "options": np.asarray(chosen, np.int32),
            "legal": np.concatenate([row[:count] for row, count in zip(decision.legal, counts, strict=True)]),
            "option_counts": np.array(counts, np.uint32),
            "observations": decision.observation,
            "observation_sizes": np.array(sizes, np.uint32),
            "log_probability": log_prob,
            "reward": decision.reward,
            "duration": decision.duration,
            "discount": low_level,
            "time_step": 1.0,
            "terminated": decision.terminated,
            "truncated": decision.truncated,
        }
        message = STORE.types[TYPE](**(fields | changes))
        self.writer.write(TOPIC, bytes(STORE.serialize_cdr(message, TYPE)), self.time)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.writer.close()


def play_into(bag, environment, policy, digest, episodes, seed=0, epoch=1):
    """Play episodes with a joint policy into an open bag and return the trajectory of each."""
    generator, number, out = np.random.default_rng(seed), 0, []
    for _ in range(episodes):
        decision, steps = environment.reset(generator), []
        while not decision.over:
            given = policy.given(decision.observation, decision.choosing, decision.running, decision.legal)
            options = given.sample(generator)
            log_prob = float(given.log_prob(options))
            bag.put(decision, options, log_prob, digest, number, epoch, environment.discount)
            before, decision = decision, environment.step(decision.named(options))
            steps.append((before, options, log_prob, decision))
            number += 1
        bag.put(decision, decision.running, 0.0, "", number, epoch, environment.discount)
        number += 1
        out.append(OptionTrajectory.of(steps))
    return out
