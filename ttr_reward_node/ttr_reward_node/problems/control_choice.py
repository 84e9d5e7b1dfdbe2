"""Which controls the solvers try.

Where every derivative is affine in the controls, the bounds are enough: the best control lies at a corner of their box.
Elsewhere it may lie anywhere between. Then evenly spaced samples span the set of velocities to about a hundredth of its
size, and a few more are put where a front of equal times would still be slowed down: against a current that is nearly
as fast as the boat, a hundredth of the boat's speed is a fifth of the way it makes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import System
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.dependence import AFFINE, dependences
from ttr_reward_node.problems.velocity_hulls import VelocityHulls

Array = NDArray[np.float64]
USUAL_COUNT = 3
"""Samples of a control that enters linearly: the bounds, and the middle, which saves switching to and fro."""
MOST_EVEN = 129
"""Evenly spaced controls that are tried at most, unless their number is asked for."""
MOST_SAMPLES = 320
"""Controls that are tried at most, unless their number is asked for."""
_ACCURACY = 0.01  # of half of the width of the set of velocities, and of the speed of a front
_MANY = 33  # samples of a control to advise at least
_DOUBTFUL = 0.06  # of that speed, from where on the samples are said to be too few


def check_control_counts(system: System, counts: int | Sequence[int]) -> None:
    """Refuse numbers of samples that are no numbers from 2 on, one for all controls or one for each.

    Raises:
        TimeToReachError: They are not.
    """
    each = [counts] if isinstance(counts, int) else list(counts)
    wrong = any(isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 2 for count in each)
    if wrong or (not isinstance(counts, int) and len(each) != len(system.controls)):
        names = ", ".join(system.control_names) or "none"
        raise TimeToReachError(
            f"control_counts are {counts}: give a whole number from 2 on, or one for each of the controls: {names}"
        )


def choose_control_counts(hulls: VelocityHulls, asked: Mapping[str, int] | None = None) -> int | tuple[int, ...]:
    """Return how many samples of each control the solvers should try.

    Args:
        hulls: Velocities of the system on its grid.
        asked: Number of samples by control name, where it is not to be chosen.

    Raises:
        TimeToReachError: There is no such control, or a number is below 2.
    """
    asked, system = {} if asked is None else dict(asked), hulls.system
    for name in asked:
        if name not in system.control_names:
            raise TimeToReachError(
                f"{system.name} has no control '{name}'; there are {', '.join(system.control_names) or 'none'}"
            )
    counts = [asked.get(name, USUAL_COUNT) for name in system.control_names]
    check_control_counts(system, counts)
    bent = _bent_controls(system)
    if not bent and not asked:
        return USUAL_COUNT
    free = [k for k in bent if system.control_names[k] not in asked]
    if free:

        def error(counts: Sequence[int]) -> float:
            return hulls.missing_width(hulls.controls(counts))

        while error(counts) > _ACCURACY:
            finer = [[2 * c - 1 if i == k else c for i, c in enumerate(counts)] for k in free]
            finer = [some for some in finer if hulls.samples(some) <= MOST_EVEN]
            if not finer:
                break
            counts = min(finer, key=error)
    return tuple(counts)


def choose_more_controls(hulls: VelocityHulls, counts: int | Sequence[int]) -> Array:
    """Return controls (k, m) to try besides evenly spaced ones: none where the system is affine in its controls."""
    even = sample_controls(hulls, counts)
    if not _bent_controls(hulls.system):
        return even[:0]
    return hulls.complete(even, _ACCURACY, MOST_SAMPLES)


def control_doubt(hulls: VelocityHulls, counts: int | Sequence[int], controls: Array) -> str:
    """Return what is wrong with the controls (k, m): a line that says what to change, empty where nothing is.

    Args:
        hulls: Velocities of the system on its grid.
        counts: Numbers of evenly spaced samples among them.
        controls: All that are tried.
    """
    system = hulls.system
    bent = _bent_controls(system)
    error = hulls.missing_speed(controls) if bent else 0.0
    if error <= _DOUBTFUL:
        return ""
    each = [counts] * len(system.controls) if isinstance(counts, int) else list(counts)
    more = " ".join(f"{system.control_names[k]}={max(2 * each[k] - 1, _MANY)}" for k in bent)
    return (
        f"the samples of the controls miss up to {100 * error:.0f} % of the speed at which the robot makes way: solve "
        f"with more, such as --controls {more}"
    )


def sample_controls(hulls: VelocityHulls, counts: int | Sequence[int]) -> Array:
    """Return evenly spaced controls (k, m): as `System.control_samples`, less the end of a whole turn.

    Where a control does the same at both bounds, as a heading does over a whole turn, the upper one is left out.
    """
    if not _bent_controls(hulls.system):
        return hulls.system.control_samples(counts)
    return hulls.controls(counts)


def _bent_controls(system: System) -> list[int]:
    """Return the controls that a derivative is not affine in, as far as the equations tell."""
    rates = [rate for rate in dependences(system) if rate.control_degree > AFFINE]
    return sorted(frozenset[int]().union(*(rate.controls for rate in rates)))
