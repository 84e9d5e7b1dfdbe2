"""Policies of every quality for a task, from a bag of its driver."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np
from ctrl_rl_learning.offline import LearningSettings, StateValues, Transitions, learn
from ctrl_rl_learning.torch import new_actor

from ctrl_rl_core import Actor, NavigationTask
from ctrl_rl_learning import LearningError

STRAIGHT, FULL = np.array((0.6, 0.0)), np.array((1.0, 1.0))


def policies(
    transitions: Transitions, task: NavigationTask, values: StateValues, seed: int, updates: int = 1500
) -> Iterator[tuple[str, Actor]]:
    """Yield eight policies with their names, from well learnt ones to those that nobody should drive by.

    What a learner refuses to learn is left out.
    """
    cloned = learn(transitions, task, LearningSettings("bc", updates // 2, hidden=64, seed=seed))

    def learnt(method: str, count: int) -> Actor:
        return learn(transitions, task, LearningSettings(method, count, hidden=64, seed=seed), values)

    with suppress(LearningError):
        yield "value_model", learnt("value_model", updates)
        yield "value_model, short", learnt("value_model", updates // 8)
    yield "value_weight", learnt("value_weight", updates // 2)
    yield "clone", cloned
    yield "straight", always(cloned, STRAIGHT)
    yield "full speed and turn", always(cloned, FULL)
    odd = ("mirrored", "blind", "random")[seed // 2 % 3]
    yield odd, {"mirrored": mirrored, "blind": blind, "random": random_network}[odd](cloned)
    yield "clone, short", learnt("bc", 30)


def always(actor: Actor, action: np.ndarray) -> Actor:
    """Return a policy of the same interface that always gives one action (2,)."""
    *inner, last = actor.weights
    *biases, _ = actor.biases
    weights, ends = (*inner, np.zeros_like(last)), (*biases, action.astype(np.float32))
    return replace(actor, weights=weights, biases=ends, squashed=False)


def mirrored(actor: Actor) -> Actor:
    """Return a policy that turns the other way."""
    flip = np.array((1.0, -1.0), np.float32)
    weights = (*actor.weights[:-1], actor.weights[-1] * flip[:, None])
    return replace(actor, weights=weights, biases=(*actor.biases[:-1], actor.biases[-1] * flip))


def blind(actor: Actor) -> Actor:
    """Return a policy that does not look at its lidar."""
    assert actor.interface is not None
    seen = np.concatenate([np.full(part.size, part.source != "scan") for part in actor.interface.observation])
    return replace(actor, weights=(actor.weights[0] * seen, *actor.weights[1:]))


def random_network(actor: Actor) -> Actor:
    """Return a policy that has learnt nothing."""
    assert actor.interface is not None
    return replace(new_actor(actor.interface, 64, actor.middle, actor.unit), manifest=actor.manifest)
