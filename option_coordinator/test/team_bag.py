"""Bags of a simulated team, as a coordinator's would be, or nearly so."""

import numpy as np
from option_coordinator.data import team_bag

from option_coordinator import OptionTrajectory

LOW_LEVEL = 0.99


class TeamBag(team_bag.TeamBag):
    """Writes a bag of any coordinator's life, and messages that no coordinator would write."""

    def __init__(self, folder):
        super().__init__(folder, LOW_LEVEL)

    def put(self, decision, chosen, log_prob, digest, number, epoch=1, low_level=LOW_LEVEL, **changes):
        """Write a decision; `changes` are made to the message."""
        numbers = {"step": number, "coordinator_epoch": epoch, "discount": low_level}
        self.write(self.fields(decision, chosen, log_prob, digest) | numbers | changes)


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
