"""Bags of a simulated team, in the format of a coordinator's bag or close to it."""

import numpy as np
from option_coordinator.data import team_bag

from option_coordinator import OptionTrajectory

LOW_LEVEL = 0.99


class TeamBag(team_bag.TeamBag):
    """Writer of a bag with an arbitrary coordinator life, including messages that no coordinator would send."""

    def __init__(self, folder):
        super().__init__(folder, LOW_LEVEL)

    def put(self, decision, chosen, log_prob, digest, number, epoch=1, low_level=LOW_LEVEL, **changes):
        """Write a decision, with `changes` applied to the message."""
        numbers = {"step": number, "coordinator_epoch": epoch, "discount": low_level}
        self.write(self.fields(decision, chosen, log_prob, digest) | numbers | changes)


def play_into(bag, environment, policy, digest, episodes, seed=0, epoch=1):
    """Write episodes of a joint policy to an open bag and return the trajectory of each."""
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
