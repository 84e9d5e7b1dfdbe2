"""Draw worlds, record a driver, learn policies, ask for verdicts as a user does, and drive the policies."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import count, islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from commands import command
from ctrl_rl_bags.datasets import TaskDriveOptions
from ctrl_rl_core.command import EXIT_USAGE
from ctrl_rl_core.io import read_json
from ctrl_rl_learning.offline import (
    TIME_TO_REACH,
    Drives,
    NoisyPolicy,
    ScriptedDriver,
    actions_of,
    clearance_of,
    drive,
    load_transitions,
    load_values,
)
from ctrl_rl_learning.sb3 import fits_fleet
from numpy.typing import NDArray
from tqdm import tqdm

from ctrl_rl_core import (
    Actor,
    CtrlRlError,
    NavigationTask,
    Outcome,
    Result,
    atomic_write,
    drive_fleet,
    load_policy,
    parse_options,
    terminal_reward,
    write_results,
)
from sim_bridge import PlanarFleet
from verdicts.policies import policies
from verdicts.worlds import DIFFERENCES, Pair, draw_pair, kind_of, write_task

KINDS = ("alike", *DIFFERENCES)
_TEST_SEED = 500_000
_FIFTH = 0.2
_AGAINST = "not called better: "
_NOISE = 0.02
"""Share of the test episodes by which a success may be lower without being called so."""


@dataclass
class Options:
    """Hold the verdicts of `evaluate_offline` to what eight policies a world then do; 1 where nothing was judged."""

    count: int = 60
    """Number of worlds."""
    seed: int = 0
    """Seed of the first world; the others follow it."""
    kind: str = ""
    """Difference between file and world; all in turn where none is given."""
    episodes: int = 60
    """Recorded episodes of a world."""
    tests: int = 60
    """Episodes by which a policy is known to be better or not."""
    updates: int = 1500
    """Updates of the best policy."""
    minutes: float = 0.0
    """Time after which no further world is begun; 0 for none."""
    work: Path = Path("runs/verdicts")
    """Folder of what was judged, a file a world: a call of the same numbers goes on where another one was cut off."""
    output: Path | None = None
    """JSON file for the results, written after each world."""
    write: Path | None = None
    """Folder to write the task files of the worlds to, for other commands; then nothing is judged."""


@dataclass(frozen=True)
class Judged:
    """A policy, what the bags said about it, and what it did.

    Attributes:
        seed: Seed of its world.
        kind: Difference between file and world.
        name: Name of the policy.
        verdict: "better", "not shown", "worse", or "refused" where the bag was refused.
        gain: Return of the policy less the driver's, as driven.
        success: Success of policy and driver, as driven.
        fifth: Return that counts as a fifth.
        said: First objection.
    """

    seed: int
    kind: str
    name: str
    verdict: str
    gain: float
    success: tuple[float, float]
    fifth: float
    said: str

    @property
    def is_better(self) -> bool:
        """Whether it earns more than the driver, and arrives as often."""
        return self.gain > 0.0 and self.success[0] >= self.success[1] - _NOISE

    @property
    def is_much_better(self) -> bool:
        """Whether it is better by a fifth of what the goal pays."""
        return self.is_better and self.gain >= self.fifth


def main() -> int:
    """Judge the policies of drawn worlds; print a line a policy that was judged wrongly, and a table."""
    options = parse_options("verdicts", Options)
    if options.kind and options.kind not in KINDS:
        print(f"verdicts: no kind {options.kind}: there are {', '.join(KINDS)}", file=sys.stderr)
        return EXIT_USAGE
    if min(options.count, options.seed + 1, options.episodes, options.tests, options.updates) < 1:
        print("verdicts: numbers must be 1 or more, --seed 0 or more", file=sys.stderr)
        return EXIT_USAGE
    seeds = islice((s for s in count(options.seed) if not options.kind or kind_of(s) == options.kind), options.count)
    if options.write is not None:
        print("\n".join(str(write_task(seed, options.write)) for seed in seeds))
        return 0
    judged: list[Judged] = []
    done: list[int] = []
    end = time.monotonic() + 60.0 * options.minutes
    for seed in tqdm(seeds, "verdicts", options.count, unit=" worlds", disable=None):
        kept = options.work / f"{seed}{options.kind}.json"
        found = _kept(kept, options)
        if found is None:
            if options.minutes and time.monotonic() > end:
                continue  # worlds that were judged before count
            with TemporaryDirectory() as folder:
                found = list(judge_world(seed, Path(folder), options))
            kept.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(kept, json.dumps({"terms": _terms(options), "judged": [asdict(each) for each in found]}))
        print("\n".join(line(each) for each in found), flush=True)
        judged += found
        done.append(seed)
        if options.output is not None and judged:
            write_results(options.output, "Verdicts from bags beside what the policies then do", done, rows(judged))
    print(table(judged))
    return int(not judged)


def _terms(options: Options) -> list[int]:
    """Return what must be the same to count what was judged before."""
    return [options.episodes, options.tests, options.updates]


def _kept(file: Path, options: Options) -> list[Judged] | None:
    """Return what an earlier call of the same numbers judged in a world; None where there is none."""
    if not file.exists():
        return None
    content = read_json(file)
    if content["terms"] != _terms(options):
        return None
    return [Judged(**{**each, "success": tuple(each["success"])}) for each in content["judged"]]


def judge_world(seed: int, folder: Path, options: Options) -> Iterator[Judged]:
    """Yield the policies of one world, judged and driven."""
    pair = draw_pair(seed, folder / "tasks", options.kind)
    bag = folder / "bag"
    drive(pair.recorded, ScriptedDriver(pair.recorded), options.episodes, 1000 * seed, bag)
    driver = drive(pair.recorded, ScriptedDriver(pair.recorded), options.tests, _TEST_SEED)
    # Steps of another length discount otherwise: returns are compared by the time of the user's file.
    step = pair.recorded.episode.time_step / pair.believed.episode.time_step
    earned = float(driver.returns(0.99**step).mean())
    transitions = load_transitions([bag], pair.believed, TaskDriveOptions(other_task=True), tell=lambda _: None)
    try:
        values = load_values(TIME_TO_REACH, pair.believed, folder / "values", clearance_of(pair.believed, None))
    except CtrlRlError:
        return  # nothing reaches the goal in what was drawn
    for number, (name, actor) in enumerate(policies(transitions, pair.believed, values, seed, options.updates)):
        file = folder / f"policy_{number}.safetensors"
        actor.save(file)
        verdict, said = ask(bag, pair, file, folder / f"told_{number}.json")
        gain, success = _driven(pair.driven, file, options.tests)
        shares = success, float(driver.success.mean())
        fifth = _FIFTH * pair.believed.rewards.goal
        yield Judged(seed, pair.kind, name, verdict, gain - earned, shares, fifth, said)


def ask(bag: Path, pair: Pair, policy: Path, results: Path) -> tuple[str, str]:
    """Return the verdict of the command, and the first line of what it says against the policy."""
    words = [str(bag), "--task", str(pair.file), "--policy", str(policy), "--other-task"]
    words += ["--updates", "200", "--fits", "2", "--results", str(results)]
    answer = command("evaluate_offline", *words, package="ctrl_rl_learning")
    lines = [each.split(": ", 1)[-1] for each in answer.stderr.splitlines()]
    if not results.exists():
        return "refused", lines[-1] if lines else ""
    against = [each for each in lines if each.startswith(_AGAINST)]
    first = against[0].removeprefix(_AGAINST) if against else ""
    told = read_json(results)["figures"]["verdict"]
    return str(told), first


def _driven(task: NavigationTask, policy: Path, tests: int) -> tuple[float, float]:
    """Return mean return and success of a policy, by a fleet where the world fits one."""
    seeds = range(_TEST_SEED, _TEST_SEED + tests)
    if fits_fleet(task):
        actor = Actor.load(policy)
        found = drive_fleet(Fleet(task), lambda observed: actions_of(actor, observed), seeds)
        outcomes = np.array([Outcome[each.outcome] for each in found], dtype=np.int64)
        drives = Drives(outcomes, found.steps, terminal_reward(outcomes, task.rewards))
    else:
        drives = drive(task, NoisyPolicy(load_policy(policy)), tests, seeds[0])
    return float(drives.returns(0.99).mean()), float(drives.success.mean())


class Fleet:
    """A fleet for `drive_fleet`, as policies observe it, in SI units."""

    def __init__(self, task: NavigationTask) -> None:
        self._task = task

    def begin(self, seeds: Sequence[int]) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """Begin an episode of each seed."""
        self._fleet = PlanarFleet(self._task, len(seeds))
        for robot, seed in enumerate(seeds):
            self._fleet.begin(robot, seed)
        return self._fleet.observations(), self._fleet.states()

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, ...]:
        """Hold actions (N, 2) for the task's time step."""
        outcomes = self._fleet.step(actions).copy()
        return self._fleet.observations(), self._fleet.states(), self._fleet.rewards(), outcomes


def line(judged: Judged) -> str:
    """Return a policy and its verdict in a line; ! marks one that was wrongly called better, ? one not found."""
    wrong = judged.verdict == "better" and not judged.is_better
    missed = judged.is_much_better and judged.verdict != "better"
    mark = "!" if wrong else "?" if missed else " "
    policy, driver = judged.success
    return (
        f"{mark} {judged.seed:>3} {judged.kind:<8} {judged.name:<20} {judged.verdict:<9} {judged.gain:+6.0f} "
        f"{policy:.2f} {driver:.2f}  {judged.said[:150]}"
    )


def of_kind(judged: Sequence[Judged]) -> dict[str, list[Judged]]:
    """Return the policies of each kind of world, and of all."""
    found = {kind: [each for each in judged if each.kind == kind] for kind in KINDS}
    return {kind: each for kind, each in {**found, "all": list(judged)}.items() if each}


def table(judged: Sequence[Judged]) -> str:
    """Return a line a kind of world."""
    form = "{:<9}{:>7}{:>9}{:>8}{:>6}{:>11}{:>7}{:>8}"
    lines = [form.format("kind", "worlds", "policies", "called", "are", "by a fifth", "found", "refused")]
    for kind, each in of_kind(judged).items():
        called, much = ([e for e in each if e.verdict == "better"], [e for e in each if e.is_much_better])
        found = sum(e.is_better for e in called), len(much), sum(e.verdict == "better" for e in much)
        refused = sum(e.verdict == "refused" for e in each)
        lines.append(form.format(kind, len({e.seed for e in each}), len(each), len(called), *found, refused))
    return "\n".join(lines)


def rows(judged: Sequence[Judged]) -> list[Result]:
    """Return the results as data: one value a policy, 1 for yes."""
    found = []
    for kind, each in of_kind(judged).items():
        called = [float(e.is_better) for e in each if e.verdict == "better"]
        worse = [float(not e.is_better) for e in each if e.verdict == "worse"]
        much = [float(e.verdict == "better") for e in each if e.is_much_better]
        columns = {
            "better that are": called,
            "better found": much,
            "worse that are": worse,
            "called better": [float(e.verdict == "better") for e in each],
            "truly better": [float(e.is_better) for e in each],
        }
        found += [Result(kind, metric, "1", values) for metric, values in columns.items() if values]
    return found
