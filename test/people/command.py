"""Drive all encounters, and print a line for each kind."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ctrl_rl_core.command import EXIT_USAGE
from ctrl_rl_core.io import add_results
from tqdm import tqdm

from ctrl_rl_core import Result, parse_options
from people.drives import Ride, ride
from people.encounters import KINDS


@dataclass
class Options:
    """Count contacts of the navigator with people, and how often it arrives; 1 if it touches somebody as it drives."""

    drives: int = 40
    """Number of drives of each kind of encounter."""
    seed: int = 0
    """Seed of the first drive; the others follow it."""
    kinds: tuple[str, ...] = KINDS
    """Kinds of encounters."""
    filters: tuple[Literal["off", "on"], ...] = ("off", "on")
    """Without and with the safety filter below the navigator."""
    name: str = "navigator"
    """Name of the navigator in the results, to compare versions."""
    output: Path | None = None
    """JSON file for the results; rows of other methods are kept."""


def main() -> int:
    """Drive; 0 if nobody is touched by a robot that drives, else 1."""
    options = parse_options("people", Options)
    unknown = [kind for kind in options.kinds if kind not in KINDS]
    if unknown or min(options.drives, options.seed + 1) < 1:
        wrong = f"no kind {unknown[0]}: there are {', '.join(KINDS)}" if unknown else "--drives: 1 or more"
        print(f"people: {wrong}; --seed: 0 or more", file=sys.stderr)
        return EXIT_USAGE
    seeds = range(options.seed, options.seed + options.drives)
    rides: dict[str, list[Ride]] = {}
    bar = tqdm(
        total=len(seeds) * len(options.kinds) * len(options.filters), desc="people", unit=" drives", disable=None
    )
    print(f"{'method':<44}{'drives':>7}{'arrived':>8}{'in motion':>10}{'standing':>9}{'of these with room':>19}")
    with bar:
        for filtered in options.filters:
            for kind in options.kinds:
                method = f"{options.name}{', filter' if filtered == 'on' else ''}, {kind}"
                rides[method] = []
                for seed in seeds:
                    rides[method].append(ride(kind, seed, filtered == "on"))
                    bar.update()
                print(line(method, rides[method]), flush=True)
                if options.output is not None:
                    add_results(options.output, "Driving among people", list(seeds), rows(method, rides[method]))
    return int(any(each.end == "contact" for all_ in rides.values() for each in all_))


def line(method: str, rides: Sequence[Ride]) -> str:
    """Return the figures of a method for people."""
    ends = [each.end for each in rides]
    room = sum(each.end == "hit" and each.room for each in rides)
    counts = f"{len(ends):>7}{ends.count('goal'):>8}{ends.count('contact'):>10}{ends.count('hit'):>9}{room:>19}"
    return f"{method:<44}{counts}"


def rows(method: str, rides: Sequence[Ride]) -> list[Result]:
    """Return the results as data, a value for each drive."""
    metrics = {
        "arrived": [each.end == "goal" for each in rides],
        "contacts in motion": [each.end == "contact" for each in rides],
        "hit while standing": [each.end == "hit" for each in rides],
        "hit while standing, with room to leave": [each.end == "hit" and each.room for each in rides],
    }
    return [Result(method, metric, "1", [float(value) for value in values]) for metric, values in metrics.items()]
