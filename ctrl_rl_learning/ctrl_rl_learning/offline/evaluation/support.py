"""What estimates rest on, tested on the bags: whether the models may be believed where the policy drives.

A model of the motion among the task's walls assumes that the walls stand where the file has them, that nothing moves
but by the task's law, that recorded commands lead in it to where they led, and that the policy drives where the bags
have been. Fitted Q evaluation assumes that the driver did what the policy would do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask
from ctrl_rl_learning.offline.data.transitions import Transitions
from ctrl_rl_learning.offline.evaluation.dynamics import fit_dynamics, inputs_of
from ctrl_rl_learning.offline.evaluation.recorded import Recorded
from ctrl_rl_learning.offline.evaluation.replay import REPLAYED, Replay
from ctrl_rl_learning.offline.evaluation.roll_outs import Fence, RollOuts, reach_of, rest_of

Array = NDArray[np.float64]
_FAST = 0.75
"""Quantile of the recorded speeds from which on pieces stand for a policy that is faster than most of them."""
_COVERED = 2.0
"""Distance from what the driver would have done up to which a command is covered, in his standard deviations."""
_SPREAD = 0.05
_UNITS = {"v": "m/s", "omega": "rad/s"}


@dataclass(frozen=True)
class ModelSupport:
    """What roll-outs rest on.

    Attributes:
        scans_off: Share of the recorded ranges that neither the task's walls nor its movers explain.
        contradicted: Share of the recorded episodes that pass through the file's obstacles, or collide far from them.
        movers: Share of the recorded ranges that end at movers.
        movers_by_law: Largest such share that the movers of the task explain.
        agreement: Correlation by which held-out pieces of the bags end in the model as in the bag.
        attainable: Correlation between two replays of those pieces, which a true model agrees by with the bag.
        pieces: Number of those pieces in the region and at the speeds that the policy drives.
        missed: Median of the distance by which those end elsewhere, as a share of their way.
        effective: Effective number of episodes that drove where the policy drives.
        outside: Share of the policy's steps where no recorded place is near.
        outside_at: Middle of those places, x and y (2,) [m]; None where there are none.
        beyond: Share of the policy's steps with commands or speeds beyond the recorded ones.
        disagreement: Difference between the largest and the least mean return of the models.
    """

    scans_off: float
    contradicted: float
    movers: float
    movers_by_law: float
    agreement: float
    attainable: float
    pieces: int
    missed: float
    effective: float
    outside: float
    outside_at: tuple[float, float] | None
    beyond: float
    disagreement: float


def model_support(recorded: Recorded, roll_outs: RollOuts, replayed: Replay, seed: int) -> ModelSupport:
    """Test on bags what roll-outs of a policy rest on."""
    transitions, task = recorded.transitions, recorded.task
    reach, dynamics = reach_of(task), fit_dynamics(transitions, rest_of(task))
    near = _near(transitions, replayed, roll_outs, reach)
    distances, nearest = Fence(transitions.states, reach).nearest(roll_outs.states)
    outside = distances > reach
    episodes = (np.cumsum(transitions.first) - 1)[nearest[~outside]]
    middle = tuple(np.median(roll_outs.states[outside, :2], axis=0).tolist()) if outside.any() else None
    inputs = inputs_of(roll_outs.actions, roll_outs.moved, roll_outs.actions)
    means = roll_outs.returns.mean(axis=1)
    movers, by_law = recorded.movers(np.random.default_rng(seed))
    return ModelSupport(
        scans_off=recorded.scans_off,
        contradicted=recorded.contradicted,
        movers=movers,
        movers_by_law=by_law,
        agreement=replayed.agreement,
        attainable=replayed.attainable,
        pieces=int(near.sum()),
        missed=_share(replayed.missed[near], replayed.driven[near]),
        effective=effective_number(np.bincount(episodes)) if len(episodes) else 0.0,
        outside=float(outside.mean()),
        outside_at=None if middle is None else (middle[0], middle[1]),
        beyond=float((dynamics.distance(inputs) > _SPREAD).mean()),
        disagreement=float(means.max() - means.min()),
    )


def effective_number(counts: NDArray[np.integer]) -> float:
    """Return how many equal parts would be as uneven as these (n,): (sum w)^2 / sum w^2."""
    return float(counts.sum() ** 2 / max(float((counts.astype(np.float64) ** 2).sum()), 1e-12))


def _near(transitions: Transitions, replayed: Replay, roll_outs: RollOuts, reach: float) -> NDArray[np.bool_]:
    """Return which pieces (n,) begin where the policy drives, and are as fast as it or among the fastest there are."""
    if not len(replayed.rows):
        return np.zeros(0, dtype=np.bool_)
    speed = float(np.median(np.abs(roll_outs.moved[:, 0])))
    asked = min(REPLAYED * speed, float(np.quantile(replayed.driven, _FAST)))
    near = ~Fence(roll_outs.states, reach).leaves(transitions.states[replayed.rows])
    return np.asarray(near & (replayed.driven >= asked))


def _share(missed: Array, driven: Array) -> float:
    return float(np.median(missed) / max(float(np.median(driven)), 0.05)) if len(missed) else math.inf


def coverage(own: NDArray[np.float32], cloned: NDArray[np.float32], given: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return whether the driver would have given the policy's actions, too (N,).

    Args:
        own: Actions (N, 2) of the policy.
        cloned: Actions (N, 2) of a clone of the driver at the same observations.
        given: Spread (2,) of the driver's actions around the clone's.
    """
    return np.asarray((np.abs(own - cloned) <= _COVERED * given).all(axis=1))


def spread_of(transitions: Transitions, cloned: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the standard deviation (2,) of the driver's actions from those of a clone (N, 2)."""
    return np.maximum((transitions.actions - cloned).std(axis=0), _SPREAD)


def commands_beyond(transitions: Transitions, task: NavigationTask, actions: NDArray[np.floating]) -> str:
    """Return which of a policy's commands (N, 2) the bags do not hold, in words; empty where they hold all."""
    out = []
    edges = np.quantile(transitions.actions, (0.01, 0.99), axis=0)
    asked = np.quantile(actions, (0.05, 0.95), axis=0)
    for index, (name, (low, high)) in enumerate(task.robot.commands.items()):
        ends = low + 0.5 * (np.stack((edges, asked))[:, :, index] + 1.0) * (high - low)
        (known_low, known_high), (least, most) = ends
        room = 0.05 * (high - low)
        unit = _UNITS.get(name, "")
        if most > known_high + room:
            out.append(f"{name} of {known_high:.2f} to {most:.2f} {unit}".rstrip())
        if least < known_low - room:
            out.append(f"{name} of {least:.2f} to {known_low:.2f} {unit}".rstrip())
    return " and ".join(out)
