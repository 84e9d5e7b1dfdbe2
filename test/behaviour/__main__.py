"""Show that behaviour stays the same: run short, seeded things and compare digests of what they leave.

python test/behaviour --output FILE [--only NAME ...] [--against FILE]

It uses only what stays as it is: commands, topics, services and files, which are read without the suite's modules.
A line is a name and the digest of its parts (tensors, topics, numbers of results); "NAME.header" is what files say
about themselves. With --against it says which parts are others than in an earlier output, and exits with 1 if any is.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from bags import BAGS  # noqa: E402  (a folder that is run, not installed)
from case import ONE_THREAD, BehaviourError, Case  # noqa: E402
from commands import CASES  # noqa: E402
from digests import Parts, whole  # noqa: E402
from report import REDUCED, differences, read_report, write_report  # noqa: E402
from stepped import STEPPED  # noqa: E402
from team import TEAM  # noqa: E402

ALL = {case.name: case for case in (*BAGS, *STEPPED, *TEAM, *CASES)}


def main() -> int:
    """Run and compare; 0 where all could be run and nothing differs, else 1."""
    parser = argparse.ArgumentParser(prog="behaviour", description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, help="JSON file to write the digests to")
    parser.add_argument("--only", nargs="+", choices=ALL, metavar="NAME", help="some (default: all); see --list")
    parser.add_argument("--against", type=Path, help="earlier output to compare with")
    parser.add_argument("--list", action="store_true", help="list the names and end")
    parser.add_argument("--keep", type=Path, help="folder to run in, kept (default: a temporary one)")
    options = parser.parse_args()
    if options.list:
        print("\n".join(ALL))
        return 0
    if options.output is None:
        parser.error("give --output FILE")
    try:
        before = None if options.against is None else read_report(options.against)
    except BehaviourError as error:
        print(f"behaviour: {error}", file=sys.stderr)
        return 2
    os.environ |= ONE_THREAD
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that the nodes that were started end too
    with tempfile.TemporaryDirectory(prefix="behaviour-") as folder:
        lines, failed = run_all(options.only or list(ALL), options.keep or Path(folder), options.output)
    print("\n".join(f"reduced  {what}: {why}" for what, why in REDUCED.items()))
    if before is not None:
        some = None if options.only is None else set(options.only)
        found = differences(before, lines, some)
        print("\n".join(found) or f"same as {options.against}: {len(lines)} lines")
        return 1 if found or failed else 0
    return 1 if failed else 0


def run_all(wanted: list[str], folder: Path, output: Path) -> tuple[dict[str, Parts], list[str]]:
    """Run cases, and before each the cases that it needs; return the lines, and the names of what failed.

    The output is written after each case: what was done is not lost where a run is cut off.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lines: dict[str, Parts] = {}
    done: set[str] = set()
    failed: list[str] = []
    for name in in_order(wanted):
        case, begin = ALL[name], time.monotonic()
        if not done.issuperset(case.after):
            failed.append(name)
            print(f"{name:<34} left out: needs {', '.join(set(case.after) - done)}", flush=True)
            continue
        try:
            found = case.run(folder)
        except Exception as error:  # whatever it is, the others are run
            failed.append(name)
            print(f"{name:<34} FAILED: {error or type(error).__name__}", flush=True)
            continue
        done.add(name)
        for line, parts in found.items() if name in wanted else ():
            lines[line] = parts
            print(f"{line:<34} {whole(parts)}  {len(parts):>4} parts", flush=True)
        write_report(output, lines)
        print(f"{name:<34} took {time.monotonic() - begin:.1f} s", file=sys.stderr, flush=True)
    return lines, failed


def in_order(wanted: list[str]) -> list[str]:
    """Return the names of cases and of what they need, each once, what is needed first."""
    order: dict[str, None] = {}

    def add(case: Case) -> None:
        for name in case.after:
            add(ALL[name])
        order[case.name] = None

    for name in wanted:
        add(ALL[name])
    return list(order)


if __name__ == "__main__":
    raise SystemExit(main())
