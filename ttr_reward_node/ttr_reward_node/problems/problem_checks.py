"""Checks of a time-to-reach problem when it is created, in Python or from a task."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Axis, Quantity, Region, System, position_indices
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.equation_checks import check_names

_PERIOD = 1e-3  # relative tolerance of a period, e.g. for 3.14 as half a turn
_MOST_DIMENSIONS = 6  # the kernels' tables hold the 2^6 corners of a cell


def check_system(system: System) -> None:
    """Check that bounds are finite and ordered, and that component names are unique.

    Raises:
        TimeToReachError: The bounds of a control or disturbance are invalid; it is named.
    """
    check_names(system)
    for quantity in (*system.controls, *system.disturbances):
        if not (math.isfinite(quantity.lower) and math.isfinite(quantity.upper) and quantity.lower <= quantity.upper):
            raise TimeToReachError(
                f"{system.name}: '{quantity.name}' is in [{quantity.lower:g}, {quantity.upper:g}]: give finite bounds, "
                "lower <= upper"
            )


def check_axes(system: System, axes: Sequence[Axis]) -> None:
    """Check that the axes match the states of a system.

    Raises:
        TimeToReachError: The axes have other names than the states, there are too many, or an axis and its state differ
            in being periodic or in the period.
    """
    names = system.state_names
    if tuple(axis.name for axis in axes) != names:
        raise TimeToReachError(
            f"the axes are {[axis.name for axis in axes]}; {system.name} needs one for each of {list(names)}"
        )
    if not 1 <= len(names) <= _MOST_DIMENSIONS:
        raise TimeToReachError(f"{system.name} has {len(names)} states; the solvers take 1 to {_MOST_DIMENSIONS}")
    for axis, state in zip(axes, system.states, strict=True):
        if state.periodic:
            _check_period(axis, state)
        elif axis.periodic:
            raise TimeToReachError(f"axis '{axis.name}' is periodic, but the state is not")


def _check_period(axis: Axis, state: Quantity) -> None:
    """Reject an axis of a periodic state that is longer than the period, or periodic with another period.

    A non-periodic axis may be at most as long as the period: a heading restricted to a range.
    """
    period, length = state.upper - state.lower, axis.upper - axis.lower
    if abs(length - period) <= _PERIOD * period or (length < period and not axis.periodic):
        return
    degrees = state.unit == "rad" and any(abs(length - turn) < 1.0 for turn in (180.0, 360.0))
    why = "it seems to be in degrees: " if degrees else ""
    other = "" if axis.periodic and length > period else ", or one that is not periodic for a part of it"
    raise TimeToReachError(
        f"axis '{axis.name}' is {length:.6g} {state.unit} long, but the state's period is {period:.6g}: {why}"
        f"give one period, such as [{state.lower:.6g}, {state.upper:.6g}] {state.unit}{other}"
    )


def least_count(periodic: bool) -> int:
    """Return the minimum number of nodes on an axis along which the system moves."""
    return 8 if periodic else 5


def check_counts(axes: Sequence[Axis], speeds: NDArray[np.float64]) -> None:
    """Check that each axis has enough nodes for a step of two or three cells.

    A periodic axis needs room for such a step in either direction and two more nodes, so that opposite steps end at
    different nodes. An axis along which nothing moves needs only two nodes.

    Args:
        axes: Axis of each state.
        speeds: Largest absolute derivative of each state (n,).

    Raises:
        TimeToReachError: An axis has too few nodes; it is named.
    """
    for axis, speed in zip(axes, speeds, strict=True):
        least = least_count(axis.periodic)
        if speed > 0.0 and axis.count < least:
            raise TimeToReachError(
                f"axis '{axis.name}' has {axis.count} nodes, too few for steps of two and three cells: give at least "
                f"{least}"
            )


def check_target(target: Region, axes: Sequence[Axis], limits: NDArray[np.float64]) -> None:
    """Check that the target is a valid set within the limits of the state (2, n).

    Raises:
        TimeToReachError: An interval or the disc is invalid; it is named.
    """
    by_name = {axis.name: k for k, axis in enumerate(axes)}
    for name, (low, high) in target.intervals.items():
        if name not in by_name:
            raise TimeToReachError(f"the target bounds '{name}'; the states are {', '.join(by_name)}")
        if not (math.isfinite(low) and math.isfinite(high) and low <= high):
            raise TimeToReachError(f"the target has '{name}' in [{low:g}, {high:g}]: give finite lower <= upper")
        _check_within(axes[by_name[name]], limits[:, by_name[name]], low, high)
    if target.disc is not None:
        plane = position_indices(list(by_name))
        if len(plane) < 2:
            raise TimeToReachError("the target is a disc, but the system has no plane of two positions")
        radius = target.disc.radius
        if not (math.isfinite(radius) and radius > 0.0 and all(map(math.isfinite, target.disc.centre))):
            raise TimeToReachError(f"the target is a disc of radius {radius:g} m: give finite numbers, above 0")
        for k, centre in zip(plane, target.disc.centre, strict=True):
            _check_within(axes[k], limits[:, k], centre - radius, centre + radius)


def _check_within(axis: Axis, limits: NDArray[np.float64], low: float, high: float) -> None:
    least, most = limits
    if high < least or low > most:
        whose = "the grid's" if high < axis.lower or low > axis.upper else "the state's own bounds,"
        raise TimeToReachError(
            f"nothing reaches the goal: it has '{axis.name}' in [{low:g}, {high:g}] {axis.unit}, outside {whose} "
            f"[{least:g}, {most:g}]"
        )


def check_clearance(spanned: Sequence[int], values: NDArray[Any], axes: Sequence[Axis]) -> None:
    """Check that a clearance fits the grid and consists of finite distances.

    Args:
        spanned: Indices of the axes of the clearance.
        values: Distances at the nodes of these axes [m].
        axes: Axes of the grid, one for each state.

    Raises:
        TimeToReachError: The clearance has other axes or another shape, or is not finite.
    """
    if not 1 <= len(spanned) <= 2 or list(spanned) != sorted(set(spanned)):
        raise TimeToReachError(f"the clearance spans axes {spanned}; give one or two, ascending")
    counts = tuple(axes[k].count for k in spanned)
    if values.shape != counts:
        raise TimeToReachError(f"the clearance has shape {values.shape}; its axes have {counts}")
    if not np.isfinite(values).all():
        raise TimeToReachError("the clearance is NaN or infinite somewhere: give distances, a large one for none")
