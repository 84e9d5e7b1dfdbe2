"""Certificate of a time-to-reach function: results of drives and backward paths, and warnings.

    certificate = certify(solution, problem)
    certificate.doubts        # one line each: where, and what to change; () if nothing is doubtful

Drives start at random states and follow the values (`drives`): if values are too small, drives do not arrive in time.
Backward paths start from the target (`paths_back`): if values are too large, these paths arrive too soon, or from
states marked unreachable. Both cost about as much as a few hundred steps of a few hundred states, whatever the grid.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import ValueGrid
from ttr_reward_node.certificates.drives import Drives, drive
from ttr_reward_node.certificates.paths_back import PathsBack, search
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.dependence import is_affine
from ttr_reward_node.problems.equation_checks import place
from ttr_reward_node.problems.problem import TimeToReachProblem

Array = NDArray[np.float64]
_NOTE = "certificate"
_STARTS = 128
_DRAWS = 32  # random states drawn per start state
# Measured on the suite's tasks and the models of thesis Table 3.1 (docs/explanation/time_to_reach.md): the medians of
# correct solutions are 0.98 to 1.03, and 90 % of the drives arrive; 70 % if a fast state has little room to move.
_ARRIVED = 0.65  # minimum fraction of conclusive drives that arrive
_FEWEST = 16  # minimum number of conclusive drives
_SLOWER, _SOONER = 1.1, 0.9  # bounds on the median of executed / predicted time
_STEPS = 3.0  # minimum difference of the median [steps]: near the target one step is a large part of the path
_OTHER = {
    "semi_lagrangian": ", or try lax_friedrichs",
    "lax_friedrichs": ", or with semi_lagrangian, which is more exact",
}


class Solved(Protocol):
    """Result of a solver: any object with a value grid."""

    @property
    def grid(self) -> ValueGrid:
        """Time-to-reach function."""


@dataclass(frozen=True)
class Certificate:
    """Results of the checks on a solution.

    Attributes:
        drives: Number of conclusive drives by the greedy policy: those that ended or made enough progress to
            extrapolate.
        arrived: Fraction of these that arrived or approach the target; None if there are none.
        ratio_median, ratio_p95: Quantiles of executed / predicted time; None if no drive arrives.
        paths: Number of backward paths, from the target and from states that reach it.
        contradictions: Number of backward paths from states that the solution marks unreachable or predicts to take
            much longer.
        doubts: One line per doubt: what is doubtful, where, and what to change.
        grid: How far the times on a coarser grid differ, in one line with what to change; "" if that is not known.
    """

    drives: int
    arrived: float | None
    ratio_median: float | None
    ratio_p95: float | None
    paths: int
    contradictions: int
    doubts: tuple[str, ...] = ()
    grid: str = ""

    @property
    def line(self) -> str:
        """Summary in one line of text."""
        if self.drives and self.arrived is not None:
            driven = f"{100 * self.arrived:.0f} % of {self.drives} drives arrive"
            if self.ratio_median is not None:
                within = f"(median; 95 % within {self.ratio_p95:.2f})"
                driven += f", taking {self.ratio_median:.3f} times the predicted time {within}"
        else:
            driven = "no drive was conclusive"
        return f"{driven}; {self.contradictions} of {self.paths} backward paths contradict the solution"

    def as_notes(self) -> dict[str, str]:
        """Return the certificate as a note for a value file."""
        return {_NOTE: json.dumps(asdict(self), allow_nan=False)}

    @classmethod
    def from_notes(cls, notes: Mapping[str, str]) -> Certificate | None:
        """Read the certificate from the notes of a value file; None if there is none.

        Raises:
            TimeToReachError: The note is not a valid certificate.
        """
        if _NOTE not in notes:
            return None
        try:
            given = json.loads(notes[_NOTE])
            arrived, median, high = (_number_or_none(given[name]) for name in ("arrived", "ratio_median", "ratio_p95"))
            drives, paths, contradictions = (int(given[name]) for name in ("drives", "paths", "contradictions"))
            if not all(isinstance(doubt, str) for doubt in given["doubts"]):
                raise TypeError("a doubt is no text")
            grid = str(given.get("grid", ""))
            return cls(drives, arrived, median, high, paths, contradictions, tuple(given["doubts"]), grid)
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise TimeToReachError(
                f"the value's certificate cannot be read ({error}): solve the task again, which writes a new one"
            ) from None


def certify(solved: ValueGrid | Solved, problem: TimeToReachProblem, *, seed: int = 0) -> Certificate:
    """Check a time-to-reach function by simulation and report what is doubtful.

    Args:
        solved: Solution of the problem, or its value grid. Certify each part of a decomposed value with its own
            problem.
        problem: Problem that was solved.
        seed: Seed for random states and controls.

    Raises:
        TimeToReachError: The axes of the grid and the problem differ.
    """
    value = solved if isinstance(solved, ValueGrid) else solved.grid
    if tuple(axis.name for axis in value.axes) != problem.system.state_names:
        raise TimeToReachError(
            f"the value has axes {list(value.state_names)}, the problem {list(problem.system.state_names)}: "
            "certify the value of this problem"
        )
    random = np.random.default_rng(seed)
    states = _starts(value, problem, random)
    paths = search(value, problem, states, random)
    drives = drive(value, problem, states)
    told = drives.told
    ratio = (drives.taken / drives.promised)[told & drives.arrives]
    median, high = np.quantile(ratio, (0.5, 0.95)) if len(ratio) else (None, None)
    doubts = (problem.control_doubt, _doubt_of_paths(paths, problem, value), _doubt_of_drives(drives, problem))
    return Certificate(
        drives=int(told.sum()),
        arrived=float(drives.arrives[told].mean()) if told.any() else None,
        ratio_median=_number_or_none(median),
        ratio_p95=_number_or_none(high),
        paths=paths.paths,
        contradictions=paths.contradictions,
        doubts=tuple(doubt for doubt in doubts if doubt),
    )


def _starts(value: ValueGrid, problem: TimeToReachProblem, random: np.random.Generator) -> Array:
    """Draw states (N, n) outside the target that reach it; random nodes if too few random states do."""
    ends = np.array([[axis.lower for axis in problem.axes], [axis.upper for axis in problem.axes]])
    lower, upper = np.clip(ends, *problem.limits)
    drawn = random.uniform(lower, upper, (_STARTS * _DRAWS, len(lower)))
    times = value.value(drawn)
    drawn = drawn[np.isfinite(times) & (times > 0.0)][:_STARTS]
    if len(drawn) == _STARTS:
        return drawn
    flat = value.values.ravel()
    nodes = np.flatnonzero(np.isfinite(flat) & (flat > 0.0))
    nodes = random.choice(nodes, min(_STARTS, len(nodes)), replace=False) if len(nodes) else nodes
    index = np.unravel_index(nodes, value.values.shape)
    return np.stack([axis.nodes[at] for axis, at in zip(problem.axes, index, strict=True)], axis=-1)


def _doubt_of_paths(paths: PathsBack, problem: TimeToReachProblem, value: ValueGrid) -> str:
    if paths.state is None:
        return ""
    claim = "calls it unreachable" if np.isinf(paths.promised) else f"says {paths.promised:.3g} s"
    other = _OTHER.get(value.solver, "") if is_affine(problem.system) else ""
    return (
        f"from {place(problem.system, paths.state)} the target is {paths.possible:.3g} s away, "
        f"but the solution {claim}; {paths.contradictions} of {paths.paths} backward paths contradict it: "
        f"{finer_advice(problem)}{other}"
    )


def _doubt_of_drives(drives: Drives, problem: TimeToReachProblem) -> str:
    told = drives.told
    if told.sum() < _FEWEST:
        return ""
    arrives = told & drives.arrives
    arrived = arrives.sum() / told.sum()
    if arrived < _ARRIVED:
        failed = np.flatnonzero(told & ~drives.arrives)
        row = failed[np.argmin(drives.promised[failed])]
        return (
            f"only {100 * arrived:.0f} % of {told.sum()} drives arrive; the one from "
            f"{place(problem.system, drives.states[row])} takes over 1.5 times the predicted "
            f"{drives.promised[row]:.3g} s: {finer_advice(problem)}"
        )
    ratio = np.median((drives.taken / drives.promised)[arrives])
    steps = np.median(((drives.taken - drives.promised) / drives.step)[arrives])
    if abs(steps) > _STEPS and not _SOONER <= ratio <= _SLOWER:
        longer = "longer" if ratio > 1.0 else "less"
        part = 100 * abs(ratio - 1.0)
        return f"the median drive takes {part:.0f} % {longer} than the solution predicts: {finer_advice(problem)}"
    return ""


def finer_advice(problem: TimeToReachProblem) -> str:
    """Return advice on which axis to refine: the one with the fewest cells overall or across the target."""

    def cells(k: int) -> float:
        axis = problem.axes[k]
        target = problem.target.intervals.get(axis.name)
        across = np.inf if target is None else 10.0 * (target.high - target.low) / axis.spacing
        return min(float(axis.count), across)

    axis = problem.axes[min(range(len(problem.axes)), key=cells)]
    return f"solve with more nodes, first along '{axis.name}' ({axis.count})"


def _number_or_none(number: float | None) -> float | None:
    if number is None:
        return None
    if not np.isfinite(float(number)):
        raise ValueError("a figure is not finite")
    return float(number)
