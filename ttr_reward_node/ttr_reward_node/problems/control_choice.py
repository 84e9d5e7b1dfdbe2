"""Choice of the control samples that the solvers try.

If every derivative is affine in the controls, the bounds suffice: the best control is a corner of their box. Otherwise
it may lie anywhere inside. Then evenly spaced samples span the set of velocities to about 1 % of its size, and a few
more are added in directions where a front of equal times would still be too slow: against a current nearly as fast as
the boat, 1 % of the boat's speed can be a fifth of its speed over ground.
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
"""Samples of a control that enters linearly: the bounds, and the middle, which avoids chattering."""
MOST_EVEN = 129
"""Maximum number of evenly spaced controls, unless set by the user."""
MOST_SAMPLES = 320
"""Maximum number of controls, unless set by the user."""
_ACCURACY = 0.01  # relative to half the width of the set of velocities, and to the speed of a front
_MANY = 33  # minimum number of samples to recommend
_DOUBTFUL = 0.06  # error relative to the speed of a front above which the samples are reported as too few


def check_control_counts(system: System, counts: int | Sequence[int]) -> None:
    """Check that sample counts are integers of at least 2, one for all controls or one for each.

    Raises:
        TimeToReachError: A count is invalid, or their number does not match the controls.
    """
    each = [counts] if isinstance(counts, int) else list(counts)
    wrong = any(isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 2 for count in each)
    if wrong or (not isinstance(counts, int) and len(each) != len(system.controls)):
        names = ", ".join(system.control_names) or "none"
        raise TimeToReachError(
            f"control_counts are {counts}: give a whole number from 2 on, or one for each of the controls: {names}"
        )


def choose_control_counts(hulls: VelocityHulls, asked: Mapping[str, int] | None = None) -> int | tuple[int, ...]:
    """Return the number of samples of each control that the solvers should try.

    Args:
        hulls: Velocities of the system on its grid.
        asked: Numbers of samples set by the user, by control name; the others are chosen.

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
    """Return controls (k, m) to add to evenly spaced ones; none if the system is affine in its controls."""
    even = sample_controls(hulls, counts)
    if not _bent_controls(hulls.system):
        return even[:0]
    return hulls.complete(even, _ACCURACY, MOST_SAMPLES)


def control_doubt(hulls: VelocityHulls, counts: int | Sequence[int], controls: Array) -> str:
    """Return a warning if the controls (k, m) are too few, with a remedy; empty if they suffice.

    Args:
        hulls: Velocities of the system on its grid.
        counts: Numbers of evenly spaced samples among them.
        controls: All controls tried.
    """
    system = hulls.system
    bent = _bent_controls(system)
    error = hulls.missing_speed(controls) if bent else 0.0
    if error <= _DOUBTFUL:
        return ""
    each = [counts] * len(system.controls) if isinstance(counts, int) else list(counts)
    more = " ".join(f"{system.control_names[k]}={max(2 * each[k] - 1, _MANY)}" for k in bent)
    return (
        f"the samples of the controls miss up to {100 * error:.0f} % of the possible speed: solve "
        f"with more, such as --controls {more}"
    )


def sample_controls(hulls: VelocityHulls, counts: int | Sequence[int]) -> Array:
    """Return evenly spaced controls (k, m), as `System.control_samples`, without duplicates of a full turn.

    If a control has the same effect at both bounds, such as a heading over a full turn, the upper bound is omitted.
    """
    if not _bent_controls(hulls.system):
        return hulls.system.control_samples(counts)
    return hulls.controls(counts)


def _bent_controls(system: System) -> list[int]:
    """Return the indices of controls in which some derivative is not affine, as far as the equations reveal."""
    rates = [rate for rate in dependences(system) if rate.control_degree > AFFINE]
    return sorted(frozenset[int]().union(*(rate.controls for rate in rates)))
