"""Draw systems, solve them, judge, and print a line a family."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from ctrl_rl_core.command import EXIT_USAGE
from tqdm import tqdm

from ctrl_rl_core import Result, parse_options, write_results
from referee.families import FAMILIES, draw, family_of
from referee.judge import Verdict, judge
from ttr_reward_node import DoubtfulValueWarning, solve


@dataclass
class Options:
    """Hold the time-to-reach solver to independent solutions of random systems; 1 where a limit is broken."""

    count: int = 200
    """Number of systems."""
    seed: int = 0
    """Seed of the first system; the others follow it."""
    family: str = ""
    """Family to draw from; all in turn where none is given."""
    jobs: int = 1
    """Number of processes."""
    output: Path | None = None
    """JSON file for the results."""
    only: int | None = None
    """Seed of one system to repeat and print."""


def main() -> int:
    """Judge systems; 0 where all limits hold, 1 where one is broken."""
    options = parse_options("referee", Options)
    if options.family and options.family not in FAMILIES:
        print(f"referee: no family {options.family}: there are {', '.join(FAMILIES)}", file=sys.stderr)
        return EXIT_USAGE
    if min(options.count, options.jobs, options.seed + 1) < 1:
        print("referee: --count and --jobs must be 1 or more, --seed 0 or more", file=sys.stderr)
        return EXIT_USAGE
    if options.only is not None:
        verdict = try_seed(options.only)
        print(describe(verdict))
        return int(verdict.wrong)
    seeds = list(islice(seeds_of(options.family, options.seed), options.count))
    verdicts = list(tqdm(judged(seeds, options.jobs), "referee", len(seeds), unit=" systems", disable=None))
    print(table(verdicts))
    if options.output is not None:
        write_results(
            options.output, "Time to reach of random systems beside independent solutions", seeds, rows(verdicts)
        )
    return int(any(verdict.wrong for verdict in verdicts))


def seeds_of(family: str, first: int) -> Iterator[int]:
    """Yield seeds from `first` on whose systems belong to a family, "" for any."""
    seed = first
    while True:
        if not family or family_of(seed) == family:
            yield seed
        seed += 1


def judged(seeds: Sequence[int], jobs: int) -> Iterator[Verdict]:
    """Yield the verdicts of the seeds, in their order."""
    if jobs == 1:
        yield from map(try_seed, seeds)
        return
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        yield from pool.map(try_seed, seeds)


def try_seed(seed: int) -> Verdict:
    """Solve the system of a seed and judge the solution; whatever the solver raises is its fault."""
    case = draw(seed)
    begin = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DoubtfulValueWarning)
            solution = solve(case.problem)
    except Exception as error:
        return Verdict(seed, case.words, fault=f"{type(error).__name__}: {error}".splitlines()[0][:200])
    verdict = judge(case, solution.grid.value, seed, seconds=time.process_time() - begin)
    doubts = () if solution.certificate is None else solution.certificate.doubts
    return replace(verdict, doubts=doubts)


def by_family(verdicts: Sequence[Verdict]) -> dict[str, list[Verdict]]:
    """Return the verdicts of each family that was drawn."""
    found = {name: [verdict for verdict in verdicts if family_of(verdict.seed) == name] for name in FAMILIES}
    return {name: each for name, each in found.items() if each}


def table(verdicts: Sequence[Verdict]) -> str:
    """Return a line a family, and below it the worst system of each one that breaks a limit."""
    head = "family", "systems", "wrong", "refused", "states", "lost", "gained", "median", "worst", "CPU s"
    lines = ["{:<12}{:>8}{:>7}{:>8}{:>9}{:>9}{:>9}{:>9}{:>9}{:>8}".format(*head)]
    faults = []
    for name, each in by_family(verdicts).items():
        medians = [v.median for v in each if np.isfinite(v.median)]
        worst = [v.worst for v in each if np.isfinite(v.worst)]
        lines.append(
            f"{name:<12}{len(each):>8}{sum(v.wrong for v in each):>7}{sum(bool(v.fault) for v in each):>8}"
            f"{sum(v.states for v in each):>9}{sum(v.lost for v in each):>9}{sum(v.gained for v in each):>9}"
            f"{max(medians, default=np.nan):>9.2%}{max(worst, default=np.nan):>9.0%}"
            f"{sum(v.seconds for v in each):>8.1f}"
        )
        wrong = sorted((v for v in each if v.wrong), key=badness, reverse=True)
        faults += [f"{name}: --only {v.seed}: {brief(v)}" for v in wrong[:3]]
    note = "lost: wrongly unreachable states; gained: wrongly reachable ones; median and worst: of the worst system"
    return "\n".join([*lines, note, *faults])


def badness(verdict: Verdict) -> tuple[bool, float, float]:
    """Return what to sort faulty systems by."""
    share = verdict.lost / max(verdict.reachable, 1) + verdict.gained / max(verdict.states - verdict.reachable, 1)
    return bool(verdict.fault), share, verdict.median if np.isfinite(verdict.median) else 0.0


def brief(verdict: Verdict) -> str:
    """Return one line."""
    if verdict.fault:
        return verdict.fault
    unreachable = verdict.states - verdict.reachable
    return (
        f"lost {verdict.lost} of {verdict.reachable}, gained {verdict.gained} of {unreachable}, median error "
        f"{verdict.median:.2%}, worst {verdict.worst:.1%}; at {verdict.at}"
    )


def describe(verdict: Verdict) -> str:
    """Return a system and its judgement whole."""
    state = "breaks a limit" if verdict.wrong else "holds"
    return (
        f"{family_of(verdict.seed)} {verdict.seed}: {verdict.words}\n{brief(verdict)}\n{verdict.seconds:.2f} s: {state}"
        + "".join(f"\nthe solution doubts itself: {doubt}" for doubt in verdict.doubts)
    )


def rows(verdicts: Sequence[Verdict]) -> list[Result]:
    """Return the results as data: one value a system."""
    found = []
    for name, each in by_family(verdicts).items():
        sound = [v for v in each if not v.fault]
        found.append(Result(name, "systems refused", "1", [float(len(each) - len(sound))]))
        for metric, unit, values in (
            ("states wrongly unreachable", "1", [float(v.lost) for v in sound]),
            ("states wrongly reachable", "1", [float(v.gained) for v in sound]),
            ("median error", "%", [100.0 * v.median for v in sound if np.isfinite(v.median)]),
            ("largest error", "%", [100.0 * v.worst for v in sound if np.isfinite(v.worst)]),
        ):
            if values:
                found.append(Result(name, metric, unit, values))
    return found
