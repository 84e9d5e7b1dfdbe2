"""Phases in which the semi-Lagrangian solver sweeps, until all that can be reached has its time.

1. Without any judgement of what is unreachable: w only grows, towards the one solution of a monotone scheme, so no node
   can come to lean on others that lean on it. Time costs little of w there: it is the share of all ways that arrive.
   Nodes below _LOST are unreachable for good.
2. Nodes below _CUT have to be reached anew, by steps of which most of the weight is reachable, which makes the edge of
   what can be reached sharp.
3. The curvature of `kernels.row_interpolation` is added; w only grows again, because a scheme with curvature is not
   monotone and would go to and fro.

Two kinds of nodes can be missed by the second phase. Where the way leads along an axis that is slow beside the others,
a step moves a small part of a cell along it, so that most of its weight is never reachable; w was small there because
the way takes long, which a first phase in which time costs almost nothing tells. And along an edge: those above _FOUND
get their times last, from steps that lean on fewer neighbours.

Finite jumps stay as wide as linear interpolation makes them, a few cells, on the side of longer times: sharpened ones
are nearer the truth on average, but who steers by them drives over the edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ttr_reward_node.kernels.sweep import SweepSettings
from ttr_reward_node.solvers.solution import Progress
from ttr_reward_node.solvers.sweeper import Sweeper

# All in units of the time that the slowest axis takes to cross a cell at its top speed.
_SETTLED = (2e-3, 0.2)  # the first and second phase hand over to the next when changes are below this; the first's of w
_PATIENCE = 40  # sweeps of the second phase, in which marginal nodes can go to and fro
_STALLED, _PROGRESS = 4, 0.7  # it also ends after so many sweeps whose changes are not this much below the least before
_QUIET = (2e-4, 0.03, 0.01)  # in each phase: a row whose changes are below this does not wake those that look at it
_LOST, _FOUND = 0.3, 0.7  # w after the first phase: below, there is no way; above, there is one
_MOST, _SOME = 0.75, 0.25  # weight of the corners that must be reachable for a step to count; at last, along an edge
_CUT = 0.985  # w of a node that the first phase leaves standing: with CROSSINGS, up to one and a half crossings
CROSSINGS = 100.0
"""1 / lambda, in crossings of the grid."""
_SLOWER = 100.0  # factor by which time costs less where it is told apart from ways that do not arrive
_FEW = 0.05  # of the nodes: fewer that were missed lie along an edge
_FLAT, _FAINT = 0.05, 1e-6  # change of ln w from a node to the next, and w, where a long way may have made it small


class Scales(NamedTuple):
    """Measures of a problem's time.

    Attributes:
        unit: Time in which the slowest axis crosses a cell at its top speed [s].
        crossing: The same for the grid's longest axis [s].
        rate: Rate lambda of the transform w = exp(-lambda phi) [1/s].
        tolerance: Largest change of phi in a sweep that ends the last phase [s].
    """

    unit: float
    crossing: float
    rate: float
    tolerance: float


@dataclass(eq=False)
class Phases:
    """Sweeps of a sweeper, counted, until they settle.

    Attributes:
        sweeper: Sweeper with the nodes.
        shape: Numbers of nodes in the layout's order.
        scales: Measures of time.
        most: Number of sweeps after which to give up.
        progress: Told of each sweep.
        number: Number of sweeps so far.
        residual: Largest change of phi in the last sweep that shows one [s].
    """

    sweeper: Sweeper
    shape: tuple[int, ...]
    scales: Scales
    most: int
    progress: Progress | None = None
    number: int = 0
    residual: float = math.inf

    def run(self) -> bool:
        """Sweep through all phases; return whether the last one has settled."""
        unit, crossing, rate, tolerance = self.scales
        fine = min(_QUIET[2] * unit, 0.1 * tolerance)
        first = SweepSettings(rate, math.inf, 0.0, _QUIET[0] / rate, False, 0, 0)
        sharp = SweepSettings(rate, crossing, _MOST, _QUIET[1] * unit, False, 0, 0)
        last = sharp._replace(quiet=fine, curved=True)
        if not self._settle(first, _SETTLED[0] / rate, least=2):
            return self._give_up()
        values = self.sweeper.values
        lost, doubtful, found = values < _LOST, values < _CUT, values >= _FOUND
        slow = self._slow(values, doubtful)
        arrived = values[slow]
        if doubtful.any():  # else nothing has lost weight: there is no edge to make sharp
            lost[slow] = False
            values[doubtful] = 0.0
            self.sweeper.restart(lost)
            if not self._settle(sharp, _SETTLED[1] * unit, least=2, patient=False):
                return self._give_up()
        self.sweeper.restart(lost)
        if not self._settle(last, tolerance):
            return self._give_up()
        return self._reach_edges(found, last) and self._reach_slow(slow, arrived, lost, last)

    def _slow(self, values: NDArray[np.float32], doubtful: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the doubtful nodes (k,) whose w may be small because the way is long, none where they are few.

        There w changes little from node to node, at least on one side along each axis.
        """
        slow = np.flatnonzero(doubtful & (values >= _FAINT))
        stride = values.size
        for count in self.shape:
            stride //= count
            at, logs, beside = slow // stride % count, np.log(values[slow]), np.zeros(len(slow), dtype=bool)
            for way, there in ((-stride, at > 0), (stride, at < count - 1)):
                near = np.maximum(values[slow[there] + way], _FAINT)
                beside[there] |= np.abs(np.log(near) - logs[there]) < _FLAT
            slow = slow[beside]
        return slow if len(slow) > _FEW * values.size else slow[:0]

    def _reach_slow(
        self,
        slow: NDArray[np.int64],
        arrived: NDArray[np.float32],
        lost: NDArray[np.bool_],
        last: SweepSettings,
    ) -> bool:
        """Give those nodes their times that only seemed lost since their ways take long; return whether it settled.

        Args:
            slow: Nodes that may be of this kind (k,).
            arrived: Their w after the first phase (k,).
            lost: Nodes that are unreachable for good (nodes,).
            last: Settings of the last phase.
        """
        missing = self.sweeper.values[slow] == 0.0
        slow, arrived = slow[missing], arrived[missing]
        if len(slow) <= _FEW * lost.size:
            return True
        times = self.sweeper.values.copy()
        others = np.ones(lost.size, dtype=bool)
        others[slow] = False
        self.sweeper.cheapen(1.0 / _SLOWER)
        self.sweeper.restart(others)
        rate = self.scales.rate / _SLOWER
        first = SweepSettings(rate, math.inf, 0.0, _QUIET[0] / rate, False, 0, 0)
        settled = self._settle(first, _SETTLED[0] / rate, least=2)
        share = self.sweeper.values[slow]
        self.sweeper.restore()
        times[slow] = np.where(share >= _CUT, arrived, 0.0)
        self.sweeper.values[:] = times
        lost[slow] = share < _LOST
        self.sweeper.restart(lost)
        return (settled and self._settle(last, self.scales.tolerance)) or self._give_up()

    def _reach_edges(self, found: NDArray[np.bool_], last: SweepSettings) -> bool:
        """Give reachable nodes along an edge times that lean on fewer neighbours; return whether it settled."""
        values = self.sweeper.values
        if not (found & (values == 0.0)).any():
            return True
        self.sweeper.restart(~found | (values > 0.0))
        edge = last._replace(enough=_SOME, curved=False)
        return self._settle(edge, self.scales.tolerance)

    def _settle(self, settings: SweepSettings, change: float, *, least: int = 1, patient: bool = True) -> bool:
        """Sweep until a sweep changes less than `change` [s]; return whether that came before the last sweep allowed.

        Args:
            settings: Settings of the phase.
            change: Change of phi that ends it [s].
            least: Number of sweeps that it takes at least.
            patient: Whether to go on for as long as it takes; else it also ends where changes no longer fall.
        """
        in_phase, best, stalled = 0, math.inf, 0
        while self.number < self.most:
            self.number += 1
            bits = in_phase % (1 << len(self.shape))
            now = self.sweeper.sweep(settings._replace(number=self.number, bits=bits), in_phase)
            in_phase += 1
            if not math.isnan(now):
                self.residual = now
            if self.progress is not None:
                self.progress(self.number, self.residual)
            if math.isnan(now):
                continue
            stalled = stalled + 1 if math.isfinite(now) and now > _PROGRESS * best else 0
            best = min(best, now)
            given_up = not patient and (in_phase >= _PATIENCE or stalled >= _STALLED)
            if (now <= change and in_phase >= least) or given_up:
                return True
        return False

    def _give_up(self) -> bool:
        """Call unreachable what has barely been reached, which would become times of hours."""
        self.sweeper.values[self.sweeper.values < _CUT] = 0.0
        return False
