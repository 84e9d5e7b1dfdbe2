"""Drive on all floors, and print a line each."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ctrl_rl_core.command import EXIT_USAGE
from ctrl_rl_navigation.driving import NavigatorState
from tqdm import tqdm

from closed_doors.best import Best
from closed_doors.drives import Outcome, drive
from closed_doors.worlds import draw_world
from ctrl_rl_core import Result, parse_options, write_results

_LIMIT = 1.5
"""Time over the best within which the robot must arrive."""
_MOST = 2
"""Number of times that a stretch may be driven in one direction."""
_ROUND, _SHUT = "a way round", "every way closed"
_LONGEST, _SPARE = 4.0, 60.0
"""Time limit of a drive: multiple of the best time, and more [s]."""


@dataclass
class Options:
    """Drive to goals where doors are closed that are open on the map; 1 if the navigator shuttles, errs or is late."""

    worlds: int = 50
    """Number of floors with a way round."""
    shut: int = 20
    """Number of floors on which every way is closed."""
    seed: int = 0
    """Seed of the first floor of each kind; the others follow it."""
    output: Path | None = None
    """JSON file for the results."""


@dataclass(frozen=True)
class Trial:
    """A drive beside the best one."""

    method: str
    seed: int
    best: Best
    outcome: Outcome

    @property
    def beyond(self) -> float:
        """Time beyond that of the best drive, which ends where it arrives or knows that every way is closed [s]."""
        return self.outcome.seconds - self.best.until

    @property
    def is_right(self) -> bool:
        """Whether the robot arrived, or said that it is blocked where every way is closed."""
        wanted = NavigatorState.REACHED if self.method == _ROUND else NavigatorState.BLOCKED
        return self.outcome.state is wanted and not self.outcome.collided

    @property
    def is_good(self) -> bool:
        """Whether that took not too long, without driving a stretch again and again."""
        soon = self.method == _SHUT or self.outcome.seconds <= _LIMIT * self.best.until
        return self.is_right and soon and self.outcome.passes <= _MOST


def main() -> int:
    """Drive; 0 where every drive is good, else 1."""
    options = parse_options("closed_doors", Options)
    if min(options.worlds, options.shut, options.seed) < 0 or options.worlds + options.shut == 0:
        print("closed_doors: --worlds, --shut, --seed: 0 or more, and at least one floor", file=sys.stderr)
        return EXIT_USAGE
    floors = [(_ROUND, options.seed + n) for n in range(options.worlds)]
    floors += [(_SHUT, options.seed + n) for n in range(options.shut)]
    trials = []
    for method, seed in tqdm(floors, desc="closed_doors", unit=" drives", disable=None):
        trials.append(run(method, seed))
        tqdm.write(line(trials[-1]))
    found = rows(trials)
    print(
        "\n".join(
            f"{row.method}: {row.metric} {np.mean(row.values):.3f}, largest {max(row.values):.3f}" for row in found
        )
    )
    if options.output is not None:
        seeds = sorted({trial.seed for trial in trials})
        write_results(options.output, "Doors that are closed in the world and open on the map", seeds, found)
    return int(not all(trial.is_good for trial in trials))


def run(method: str, seed: int) -> Trial:
    """Draw a floor, and drive on it."""
    world, best = draw_world(seed, method == _SHUT)
    return Trial(method, seed, best, drive(world, seed, _LONGEST * best.until + _SPARE))


def line(trial: Trial) -> str:
    """Return what became of a drive."""
    best, out = trial.best, trial.outcome
    return (
        f"{trial.method} {trial.seed}: {out.state.name.lower()} after {out.seconds:.1f} s, best {best.until:.1f} s "
        f"({trial.beyond:+.1f} s), {best.learnt} closed doors seen by it, passes {out.passes}, values {out.solves}"
        f"{', touched something' if out.collided else ''}{'' if trial.is_good else ' <-- ' + out.message}"
    )


def rows(trials: list[Trial]) -> list[Result]:
    """Return the results as data."""
    out = []
    for method in (_ROUND, _SHUT):
        own = [trial for trial in trials if trial.method == method]
        if not own:
            continue
        right = "arrived" if method == _ROUND else "blocked said"
        if method == _ROUND:
            ratios = [trial.outcome.seconds / trial.best.until for trial in own]
            out.append(Result(method, "time over best", "1", ratios))
        out += [
            Result(method, right, "1", [float(trial.is_right) for trial in own]),
            Result(method, "contacts", "1", [float(trial.outcome.collided) for trial in own]),
            Result(method, "time beyond best", "s", [trial.beyond for trial in own]),
            Result(method, "passes of a stretch", "1", [float(trial.outcome.passes) for trial in own]),
            Result(method, "values solved", "1", [float(trial.outcome.solves) for trial in own]),
        ]
    return out
