"""Phases of the semi-Lagrangian sweeps, until every reachable node has its time.

1. No node is judged unreachable: w only grows, towards the unique solution of a monotone scheme, so no nodes can
   support each other in a loop. Time is discounted so little that w is about the fraction of interpolation weight that
   arrives. Nodes below _LOST are marked unreachable for good.
2. Nodes below _CUT are reset and must be reached again, by steps with most of their weight on reachable nodes, which
   sharpens the edge of the reachable set.
3. The curvature of `kernels.row_interpolation` is added; w again only grows, because a scheme with curvature is not
   monotone and would oscillate.

The second phase can miss two kinds of nodes. If the path follows an axis that is slow compared with the others, a step
moves a small fraction of a cell along it, so most of its weight is never reachable; w was small there because the path
takes long, which a first phase with an almost negligible discount reveals. And along an edge, the nodes above _FOUND
get their times last, from steps that need fewer reachable neighbours.

Finite jumps remain as wide as linear interpolation makes them, a few cells, on the side of longer times: sharpened
jumps are more accurate on average, but a robot that follows them drives over the edge.
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

# Changes are in units of the time that the slowest axis needs to cross a cell at its top speed, except those of w.
_SETTLED = (2e-3, 0.2)  # largest change at which the first (change of w) and the second phase end
_PATIENCE = 40  # maximum number of sweeps of the second phase, in which marginal nodes can oscillate
_STALLED, _PROGRESS = 4, 0.7  # it also ends after 4 sweeps with changes above 0.7 times the smallest before
_QUIET = (2e-4, 0.03, 0.01)  # per phase: smaller changes of a row do not trigger updates of the rows that read it
_LOST, _FOUND = 0.3, 0.7  # w after the first phase below which a node is unreachable, and above which it is reachable
_MOST, _SOME = 0.75, 0.25  # minimum weight of the reachable corners for a step to count; and finally, along an edge
_CUT = 0.985  # w below which a node is reset after the first phase: with CROSSINGS, paths of 1.5 crossings are kept
CROSSINGS = 100.0
"""1 / lambda, in times to cross the grid."""
_SLOWER = 100.0  # factor of lower discount that separates long paths from paths that do not arrive
_FEW = 0.05  # fraction of missed nodes below which they lie along an edge
_BLOCK = 1 << 13  # number of nodes examined at once
_FLAT, _FAINT = 0.05, 1e-6  # largest change of ln w between neighbours, and smallest w, attributed to a long path


class Scales(NamedTuple):
    """Time scales of a problem.

    Attributes:
        unit: Time for the slowest axis to cross a cell at its top speed [s].
        crossing: `unit` times the number of nodes on the longest axis [s].
        rate: Rate lambda of the transform w = exp(-lambda phi) [1/s].
        tolerance: Largest change of phi in a sweep that ends the last phase [s].
    """

    unit: float
    crossing: float
    rate: float
    tolerance: float


@dataclass(eq=False)
class Phases:
    """Runs a sweeper through all phases until it converges.

    Attributes:
        sweeper: Sweeper with the nodes.
        shape: Number of nodes on each axis, in the layout's order.
        scales: Time scales.
        most: Maximum number of sweeps.
        progress: Function called after each sweep.
        number: Number of sweeps so far.
        residual: Largest change of phi in the last sweep that measured it [s].
    """

    sweeper: Sweeper
    shape: tuple[int, ...]
    scales: Scales
    most: int
    progress: Progress | None = None
    number: int = 0
    residual: float = math.inf

    def run(self) -> bool:
        """Sweep through all phases; return whether the last one has converged."""
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
        blurred = bool(doubtful.any())  # otherwise no weight was lost, and there is no edge to sharpen
        values[doubtful] = 0.0
        del doubtful  # a byte a node
        if blurred:
            lost[slow] = False
            self.sweeper.restart(lost)
            if not self._settle(sharp, _SETTLED[1] * unit, least=2, patient=False):
                return self._give_up()
        self.sweeper.restart(lost)
        if not self._settle(last, tolerance):
            return self._give_up()
        return self._reach_edges(found, last) and self._reach_slow(slow, arrived, lost, last)

    def _slow(self, values: NDArray[np.float32], doubtful: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the doubtful nodes (k,) whose w may be small because of a long path; none if they are few.

        At such a node w changes little from node to node, at least towards one side along each axis.
        """
        found = []
        for begin in range(0, values.size, _BLOCK):
            some = slice(begin, begin + _BLOCK)
            found.append(self._smooth(values, begin + np.flatnonzero(doubtful[some] & (values[some] >= _FAINT))))
        slow = np.concatenate(found)
        return slow if len(slow) > _FEW * values.size else slow[:0]

    def _smooth(self, values: NDArray[np.float32], nodes: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return those of some nodes (k,) at which w changes little, at least towards one side along each axis."""
        stride = values.size
        for count in self.shape:
            stride //= count
            at, logs, beside = nodes // stride % count, np.log(values[nodes]), np.zeros(len(nodes), dtype=bool)
            for way, there in ((-stride, at > 0), (stride, at < count - 1)):
                near = np.maximum(values[nodes[there] + way], _FAINT)
                beside[there] |= np.abs(np.log(near) - logs[there]) < _FLAT
            nodes = nodes[beside]
        return nodes

    def _reach_slow(
        self,
        slow: NDArray[np.int64],
        arrived: NDArray[np.float32],
        lost: NDArray[np.bool_],
        last: SweepSettings,
    ) -> bool:
        """Compute the times of nodes that seemed unreachable because their paths are long; return whether it converged.

        Args:
            slow: Candidate nodes (k,).
            arrived: Their w after the first phase (k,).
            lost: Nodes marked unreachable for good (nodes,).
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
        """Compute the times of reachable nodes along an edge from fewer neighbours; return whether it converged.

        Long steps count as well: where the edge runs almost along a row of nodes, a short one ends so close to that row
        that the reachable nodes beside it have no weight.
        """
        values = self.sweeper.values
        if not (found & (values == 0.0)).any():
            return True
        self.sweeper.restart(~found | (values > 0.0))
        self.sweeper.admit_long(True)
        edge = last._replace(enough=_SOME, curved=False)
        converged = self._settle(edge, self.scales.tolerance)
        self.sweeper.admit_long(False)
        return converged

    def _settle(self, settings: SweepSettings, change: float, *, least: int = 1, patient: bool = True) -> bool:
        """Sweep until a sweep changes at most `change` [s]; return whether that happened within the sweep limit.

        Args:
            settings: Settings of the phase.
            change: Change of phi that ends the phase [s].
            least: Minimum number of sweeps.
            patient: Whether to continue as long as it takes; otherwise also end when changes stop decreasing.
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
        """Mark nodes with small w as unreachable: they would otherwise show times of hours."""
        self.sweeper.values[self.sweeper.values < _CUT] = 0.0
        return False
