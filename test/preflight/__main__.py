"""Plant faults into a simulated robot one after the other, and count which of them the pre-flight finds.

python test/preflight [--results docs/results/preflight.json] [--only "slow scan" ...] [--seeds 1]
"""

from __future__ import annotations

import os
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ctrl_rl_core.command import EXIT_USAGE, OptionalFileToWrite, Positive

from ctrl_rl_core import Result, parse_options, write_results

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))

from planted import FAULTS, HEALTHY, Answer, look_at

_BUSY = ("--scan-rate", "2", "--odom-rate", "5", "--largest-gap", "1")
HEALTHY_NAME = "healthy robot"


@dataclass(frozen=True)
class Options:
    """Plant faults into a simulated robot, and count which of them the pre-flight finds."""

    results: OptionalFileToWrite = None
    """JSON file to write the results to."""

    only: tuple[str, ...] = ()
    """Names of the faults; all, and a healthy robot, where none is given."""

    seeds: Positive = 1
    """Number of robots for each fault, with seeds from 0."""

    jobs: Positive = 1
    """Number of robots at a time."""

    busy: bool = False
    """Bear a busy machine: scans at 2 Hz and gaps of 1 s pass where the fault is none of time."""


def main() -> int:
    """Run all faults; 0 where each is found and the healthy robot passes."""
    options = parse_options("preflight", Options)
    chosen = options.only or (*FAULTS, HEALTHY_NAME)
    if unknown := sorted(set(chosen) - {HEALTHY_NAME, *FAULTS}):
        print(f"preflight: no fault '{unknown[0]}': there are {', '.join(FAULTS)}", file=sys.stderr)
        return EXIT_USAGE
    rows, said = [], {}
    with ThreadPoolExecutor(options.jobs) as pool:
        looks = {name: pool.submit(look, name, number * options.seeds, options) for number, name in enumerate(chosen)}
    for name in chosen:
        answers = looks[name].result()
        found = [float(answer.finds(FAULTS.get(name, HEALTHY))) for answer in answers]
        rows.append(Result(name, "passed" if name == HEALTHY_NAME else "found", "1", found))
        said[name] = [_no_gos(answer) for answer in answers]
        print(f"{name:<32} {found}  {said[name][0]}", flush=True)
        if min(found) < 1.0:
            print(answers[found.index(0.0)].output, file=sys.stderr, flush=True)
    if options.results is not None:
        write_results(options.results, "preflight", range(options.seeds), rows, {"no-go": said})
    return 0 if all(min(row.values) == 1.0 for row in rows) else 1


def look(name: str, first: int, options: Options) -> list[Answer]:
    """Return what is said of robots with one fault, each in a ROS domain of its own, from number `first` on."""
    with tempfile.TemporaryDirectory() as folder:
        return [
            look_at(
                name,
                Path(folder) / str(seed),
                1 + (os.getpid() + first + seed) % 100,
                seed,
                _BUSY if options.busy else (),
            )
            for seed in range(options.seeds)
        ]


def _no_gos(answer: Answer) -> list[str]:
    return [f"{each['check']}: {each['text']}" for each in answer.findings if each["level"] == "NO-GO"]


if __name__ == "__main__":
    raise SystemExit(main())
