"""Attack the suite: fuzz its readers and messages, break its processes, for as long as one gives it.

python test/attack [--seconds 600] [--seed 0] [--only NAME ...] [--report FILE]

Each round runs in a process of its own, so that a crash, a hang or a flood of memory is a fault of that round alone.
A fault is brought about again by the command that the report names.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from ctrl_rl_core.command import EXIT_USAGE
from tqdm import tqdm

from ctrl_rl_core import parse_options

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from _attack import Attack  # noqa: E402  (a folder that is run, not installed)
from _fault_tests import FAULT_TESTS  # noqa: E402

_LONGEST_TEXT = 4000


@dataclasses.dataclass
class Outcome:
    """How one attack went: its rounds, the time they took [s], its faults."""

    name: str
    promise: str
    rounds: int = 0
    seconds: float = 0.0
    faults: list[dict[str, object]] = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class Options:
    """Run attacks round after round, and report what broke."""

    seconds: float = 600.0
    """Time to attack [s]."""
    seed: int = 0
    """Seed of the first round."""
    only: tuple[str, ...] = ()
    """Names of the attacks; all where none is given."""
    report: Path | None = None
    """JSON file of the report."""
    list: bool = False
    """List the attacks and their promises."""
    round: bool = False
    """Run one round of --only with --seed in this process."""


def main() -> int:
    """Run rounds until the time is over; 0 where nothing broke, 1 where something did."""
    attacks = {attack.name: attack for attack in load()}
    options = parse_options("attack", Options)
    if unknown := sorted(set(options.only) - attacks.keys()):
        print(f"attack: no attack {unknown[0]}: there are {', '.join(attacks)}", file=sys.stderr)
        return EXIT_USAGE
    chosen = [attacks[name] for name in options.only or attacks]
    if options.list:
        print("\n".join(f"{attack.name:<24} {attack.promise}" for attack in chosen))
        return 0
    if options.round:
        for attack in chosen:
            one_round(attack, options.seed)
        return 0
    outcomes = attack_for(chosen, options.seconds, options.seed)
    if options.report is not None:
        options.report.parent.mkdir(parents=True, exist_ok=True)
        report = {
            "seed": options.seed,
            "seconds": options.seconds,
            "attacks": [dataclasses.asdict(o) for o in outcomes],
        }
        options.report.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    print(table(outcomes))
    return 1 if any(outcome.faults for outcome in outcomes) else 0


def load() -> list[Attack]:
    """Return the attacks of all modules in this folder, the fault tests last."""
    modules = sorted(file.stem for file in HERE.glob("*.py") if not file.stem.startswith("_"))
    return [attack for module in modules for attack in importlib.import_module(module).ATTACKS] + [FAULT_TESTS]


def attack_for(attacks: list[Attack], seconds: float, seed: int) -> list[Outcome]:
    """Run rounds of all attacks in turn until `seconds` are over; each attack has one round at least."""
    outcomes = {attack.name: Outcome(attack.name, attack.promise) for attack in attacks}
    begin = time.monotonic()
    with tqdm(total=round(seconds), desc="attack", unit="s", disable=None) as bar:
        for number, attack in in_turn(attacks):
            if number and time.monotonic() - begin >= seconds:
                break
            bar.set_postfix_str(attack.name)
            outcome, started = outcomes[attack.name], time.monotonic()
            fault = in_own_process(attack, seed + number)
            outcome.rounds += 1
            outcome.seconds += time.monotonic() - started
            if fault is not None:
                again = f"python test/attack --round --only {attack.name} --seed {seed + number}"
                outcome.faults.append({"seed": seed + number, "fault": fault, "again": again})
                tqdm.write(f"{attack.name}: {fault.strip().splitlines()[-1]}\n  again: {again}")
            bar.n = min(round(time.monotonic() - begin), bar.total)
            bar.refresh()
    return list(outcomes.values())


def in_turn(attacks: list[Attack]) -> Iterator[tuple[int, Attack]]:
    """Yield (number of the round, attack) for ever; attacks that do not repeat come once."""
    number = 0
    while number == 0 or any(attack.repeats for attack in attacks):
        for attack in attacks:
            if number == 0 or attack.repeats:
                yield number, attack
        number += 1


def in_own_process(attack: Attack, seed: int) -> str | None:
    """Run one round in a process of its own and return its fault, None where there is none."""
    command = [sys.executable, str(HERE), "--round", "--only", attack.name, "--seed", str(seed)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace", start_new_session=True
    )
    try:
        said, _ = process.communicate(timeout=attack.limit_s)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        said, _ = process.communicate()
        return f"{said[-_LONGEST_TEXT:]}\nhung for {attack.limit_s:g} s"
    return None if process.returncode == 0 else f"{said[-_LONGEST_TEXT:]}\nended with {process.returncode}"


def one_round(attack: Attack, seed: int) -> None:
    """Run one round in this process."""
    if attack.memory is not None:
        resource.setrlimit(resource.RLIMIT_AS, (attack.memory, attack.memory))
    with tempfile.TemporaryDirectory(prefix="attack-") as folder:
        attack.run(np.random.default_rng(seed), Path(folder))


def table(outcomes: list[Outcome]) -> str:
    """Return the outcomes for people."""
    lines = [f"{'attack':<24} {'rounds':>6} {'seconds':>8} {'faults':>6}"]
    lines += [f"{o.name:<24} {o.rounds:>6} {o.seconds:>8.0f} {len(o.faults):>6}" for o in outcomes]
    return "\n".join(lines)


if __name__ == "__main__":
    raise SystemExit(main())
