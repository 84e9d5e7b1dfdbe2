"""The page of capabilities: which kinds of tasks each command supports, and which parts a task needs."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import yaml
from ctrl_rl_core.tasks import COMMANDS, TaskHeader, unmet
from ctrl_rl_navigation.maps import map_file

from ctrl_rl_core import load_task, task_file
from option_coordinator import load_team

_HEAD = """# What each command takes

Each command that is given a task, and each kind of task.

- `yes`: it works. The table comes from the code, which each command uses to check its task.
- A part's name: it works where the task file has that part.
- `no`: it refuses in one line. The reasons are below.

A [task](../tasks.md) on a map has `map:` in place of `arena:` or `corridor:`. In an arena or on a map with the states
x, y and theta no `grid` is needed: where there is none, nodes lie 0.1 m and 5 degrees apart.
`ctrl_rl_trials train` and `hardness` simulate many robots at once, so they refuse `movers`, `randomisation` and robots
with steered wheels, which `ttr_reward_node train` takes.
"""
_SUITE = {
    "arena, wheels": "car_navigation",
    "arena, quadrotor": "quad_navigation",
    "corridor": "curved_corridor",
    "corridor, doorways": "corridor_doorways",
    "jars or tools": "tool_delivery",
}
MAP, TEAM = "map, wheels", "team file"


def examples(folder: Path) -> dict[str, str]:
    """Return an example task of each kind, by name or file; write the one with a map to a folder."""
    content = yaml.safe_load(task_file("car_navigation").read_text(encoding="utf-8"))
    content |= {"name": "on_a_map", "map": {"file": str(map_file("maze"))}}
    for part in ("arena", "obstacles", "optimal_control"):
        content.pop(part, None)
    content["start"] = {"x": "0.5 .. 3.0 m", "y": "0.5 .. 3.0 m", "theta": "-180.0 .. 180.0 deg"}
    content["robot"] = {"body": "turtlebot3_burger"}
    content["system"]["controls"] = {"v": "0.2 m/s", "omega": "-robot .. robot rad/s"}
    own = folder / "on_a_map.yaml"
    own.write_text(yaml.safe_dump(content), encoding="utf-8")
    return _SUITE | {MAP: str(own), TEAM: "delivery_team"}


def load(kind: str, name: str) -> TaskHeader:
    """Load a task of a given kind."""
    return load_team(name) if kind == TEAM else load_task(name)


def capability_page() -> str:
    """Return the page, with the table and each reason with its commands."""
    with tempfile.TemporaryDirectory() as folder:
        return _page({kind: load(kind, name) for kind, name in examples(Path(folder)).items()})


def _page(tasks: Mapping[str, TaskHeader]) -> str:
    lines = [_HEAD, f"| command | {' | '.join(tasks)} |", "|---" * (len(tasks) + 1) + "|"]
    reasons: dict[str, list[str]] = {}
    uses = Counter(_executable(command) for command in COMMANDS)
    for command in COMMANDS:
        cells, short = [], _executable(command)
        for task in tasks.values():
            need = unmet(command, task)
            cells.append("yes" if need is None else f"`{need.part}`" if need.part else "no")
            if need is not None:
                reasons.setdefault(need.lacks(task), []).append(f"`{command if uses[short] > 1 else short}`")
        lines.append(f"| `{command}` | {' | '.join(cells)} |")
    lines += ["", "## Reasons", "", "A task that ...", "", "| | is refused by |", "|---|---|"]
    lines += [f"| {reason} | {', '.join(dict.fromkeys(names))} |" for reason, names in reasons.items()]
    return "\n".join(lines) + "\n"


def _executable(command: str) -> str:
    """Return a command without its package."""
    return command.split(" ", 1)[1]
