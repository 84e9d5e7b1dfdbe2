"""The semi-Lagrangian solver: from each node to where the controls take it in a few cells, until nothing changes.

It sweeps in three phases. First without any judgement of what is unreachable: w only grows, towards the one solution of
a monotone scheme, so no node can come to lean on others that lean on it. Time costs little of w there: it is the share
of all ways that arrive. Nodes below _LOST are unreachable for good. Those below _CUT have to be reached anew in the
second phase, by steps of which most of the weight is reachable, which makes the edge of what can be reached sharp. Then
the curvature of `kernels.row_interpolation` is added; w only grows again, because a scheme with curvature is not
monotone and would go to and fro. Nodes above _FOUND that such steps have missed, along an edge, get their times last.

Finite jumps stay as wide as linear interpolation makes them, a few cells, on the side of longer times: sharpened ones
are nearer the truth on average, but who steers by them drives over the edge.
"""

from __future__ import annotations

import math

import numpy as np

from ttr_reward_node.kernels.stencil import StepTable, make_grid
from ttr_reward_node.kernels.sweep import SweepSettings
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.solvers.devices import CPU, find_device
from ttr_reward_node.solvers.near_nodes import near_share
from ttr_reward_node.solvers.solution import Progress, SweepResult, require_memory
from ttr_reward_node.solvers.steps import make_layout, make_steps, pairs, step_lengths, tried_controls

# All in units of the time that the slowest axis takes to cross a cell at its top speed.
_TOLERANCE = 0.1
_SETTLED = (2e-3, 0.2)  # the first and second phase hand over to the next when changes are below this; the first's of w
_PATIENCE = 40  # sweeps of the second phase, in which marginal nodes can go to and fro
_STALLED, _PROGRESS = 4, 0.7  # it also ends after so many sweeps whose changes are not this much below the least before
_QUIET = (2e-4, 0.03, 0.01)  # in each phase: a row whose changes are below this does not wake those that look at it
_LOST, _FOUND = (
    0.3,
    0.7,
)  # w after the first phase, about the share of all ways that arrive: below, there is none; above, there is one
_MOST, _SOME = 0.75, 0.25  # weight of the corners that must be reachable for a step to count; at last, along an edge
_CUT = 0.985  # w of a node that the first phase leaves standing; with _CROSSINGS, up to one and a half crossings
_CROSSINGS = 100.0  # 1 / lambda, in crossings of the grid

_LONG = 3.5  # cells: a longer step has to end where all is known and smooth


def memory_needed(problem: TimeToReachProblem) -> float:
    """Return the bytes that `solve` will take at most, with those of the value grid."""
    layout = make_layout(problem)
    lengths = step_lengths(problem)
    n_pairs = len(lengths) * len(pairs(problem, tried_controls(problem, layout))[0])
    # Durations, and once more while they are numbered; numbers, ends and ranges.
    steps = layout.slabs * n_pairs * (14.0 + 2.0 * len(layout.order) + 2.0 * len(layout.inner))
    near = near_share(problem, max(lengths)) * problem.points * n_pairs * 4.0
    rows = 40.0 * problem.points / layout.counts[-1]
    return steps + near + rows + problem.points * 21.0 + 2.5e8  # the last for compiling


def solve(
    problem: TimeToReachProblem,
    *,
    tolerance: float | None = None,
    max_sweeps: int = 300,
    progress: Progress | None = None,
    device: str = CPU,
) -> SweepResult:
    """Solve a problem, with the arguments of `solver.solve`."""
    require_memory(memory_needed(problem), problem.points)
    use = find_device(device)
    layout = make_layout(problem)
    steps = make_steps(problem, layout)
    unit = steps.crossing
    tolerance = _TOLERANCE * unit if tolerance is None else tolerance
    crossing = unit * max(layout.counts)
    rate = 1.0 / (_CROSSINGS * crossing) if crossing > 0.0 else 1.0
    axes = len(layout.order)
    grid = make_grid(layout.counts[:axes], layout.periodic[:axes], len(layout.outer))
    discounts = np.exp(-rate * steps.durations).astype(np.float32)
    discounts[0] = 0.0
    long = steps.lengths > _LONG
    table = StepTable(steps.codes, steps.ends, steps.ranges, long, steps.controls, discounts, steps.durations)
    sweeper = use(problem, layout, steps, table, grid, rate)
    coarse, fine = _QUIET[1] * unit, min(_QUIET[2] * unit, 0.1 * tolerance)
    phases = [
        SweepSettings(rate, math.inf, 0.0, _QUIET[0] / rate, False, 0, 0),
        SweepSettings(rate, crossing, _MOST, coarse, False, 0, 0),
        SweepSettings(rate, crossing, _MOST, fine, True, 0, 0),
    ]
    residual, number, in_phase, least, stalled = math.inf, 0, 0, math.inf, 0
    lost = found = np.zeros(1, dtype=bool)
    while number < max_sweeps:
        number += 1
        change = sweeper.sweep(phases[0]._replace(number=number, bits=in_phase % (1 << axes)), in_phase)
        in_phase += 1
        residual = residual if math.isnan(change) else change
        if progress is not None:
            progress(number, residual)
        if math.isnan(change):
            continue
        stalled = stalled + 1 if math.isfinite(change) and change > _PROGRESS * least else 0
        least = min(least, change)
        first, last = math.isinf(phases[0].jump), len(phases) == 1
        if last and residual <= tolerance:
            if phases[0].enough == _MOST and (found & (sweeper.values == 0.0)).any():
                # What is reachable, but lies along an edge: with times that lean on fewer neighbours.
                phases, last = [phases[0], phases[0]._replace(enough=_SOME, curved=False)], False
                lost = ~found | (sweeper.values > 0.0)
            else:
                break
        settled = not last and residual <= (_SETTLED[0] / rate if first else _SETTLED[1] * unit) and in_phase > 1
        if settled or (not last and not first and (in_phase >= _PATIENCE or stalled >= _STALLED)):
            if first:
                values = sweeper.values
                lost, doubtful, found = values < _LOST, values < _CUT, values >= _FOUND
                if not doubtful.any():  # nothing has lost weight: there is no edge to make sharp
                    phases.pop(0)
                values[doubtful] = 0.0
            phases.pop(0)
            sweeper.restart(lost)
            in_phase, least, stalled = 0, math.inf, 0
    values = sweeper.values
    if len(phases) > 1:  # given up: what has barely been reached would become times of hours
        values[values < _CUT] = 0.0
    with np.errstate(divide="ignore"):
        np.log(values, out=values)
    values *= np.float32(-1.0 / rate)
    phi = np.abs(values).reshape([problem.counts[k] for k in layout.order]).transpose(np.argsort(layout.order))
    return SweepResult(np.ascontiguousarray(phi), number, residual, len(phases) == 1 and residual <= tolerance)
