"""The output of a run, and how two of them differ."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from case import BehaviourError
from digests import Parts, whole

REDUCED = {
    "times, commits, command lines, digests of whole files": "differ between days, machines and wordings; left out",
    "printed lines": "numbers alone, as words may be put better",
    "diagnostics, rosout, tf, /clock": "by wall time; the drives hear sensors, commands, latents, rewards, values",
    "a drive in real time": "who hears odometry before a scan is chance; so messages are passed on in order",
    "a watchdog's zeros": "by wall time; the commands that answer a scan count",
    "a coordinator's epoch, stamps of grants": "drawn, and by wall time; left out",
    "alignment of a bag": "has no command of its own; seen in koopman_train, koopman_evaluate and relabel",
    "MAPPO from bags": "needs the file of the policy that was recorded; imitation from bags is run",
}
"""What is not told to the last bit, or not by itself, and why."""
_LIBRARIES = ("numpy", "scipy", "torch", "numba", "casadi", "pybullet", "mujoco", "stable-baselines3")
_SHOWN = 8
"""Parts of a line that are named."""


def write_report(file: Path, lines: Mapping[str, Parts]) -> None:
    """Write lines with their parts, and what they were made with."""
    made_with = {"machine": platform.machine(), "python": platform.python_version()}
    made_with |= {name: version(name) for name in _LIBRARIES}
    report = {
        "made_with": made_with,
        "reduced": REDUCED,
        "lines": {
            name: {"digest": whole(parts), "parts": dict(sorted(parts.items()))} for name, parts in lines.items()
        },
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


def read_report(file: Path) -> dict[str, Parts]:
    """Return the lines of an earlier output.

    Raises:
        BehaviourError: it is none.
    """
    try:
        lines = json.loads(file.read_text(encoding="utf-8"))["lines"]
        return {name: dict(line["parts"]) for name, line in lines.items()}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BehaviourError(f"{file} is no output of this command: {error}") from None


def differences(before: Mapping[str, Parts], now: Mapping[str, Parts], cases: set[str] | None) -> list[str]:
    """Return what differs, a line for each; `cases` are those that were run, None for all."""
    out = []
    for name in dict.fromkeys((*before, *now)):
        if name not in now:
            if cases is None or name.partition(".")[0] in cases:
                out.append(f"LOST     {name}")
        elif name not in before:
            out.append(f"NEW      {name}")
        elif before[name] != now[name]:
            out.append(f"DIFFERS  {name}: {_which(before[name], now[name])}")
    return out


def _which(before: Parts, now: Parts) -> str:
    kinds = {
        "changed": [name for name in before if name in now and before[name] != now[name]],
        "lost": [name for name in before if name not in now],
        "gained": [name for name in now if name not in before],
    }
    told = [f"{kind} {len(names)}: {', '.join(names[:_SHOWN])}" for kind, names in kinds.items() if names]
    return "; ".join(told)
