"""Worlds drawn by a seed, each with the task file that its user has: alike, or different in one way."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ctrl_rl_core import NavigationTask, load_navigation_task

NAME = "drawn"
DIFFERENCES = ("place", "one box", "size", "number", "period", "delay", "lidar", "movers")
_START, _GOAL, _ROOM = np.array((-3.0, -3.0)), np.array((3.0, 3.0)), 1.2


@dataclass(frozen=True)
class Pair:
    """A world, and what its user believes it to be.

    Attributes:
        kind: Way in which they differ, one of `DIFFERENCES`, or "alike".
        file: Task file of the user.
        believed: Its task.
        recorded: Task of the world as the driver drives and records.
        driven: Task of the world as policies drive: by the period of the user's file.
    """

    kind: str
    file: Path
    believed: NavigationTask
    recorded: NavigationTask
    driven: NavigationTask


def kind_of(seed: int) -> str:
    """Return the difference of a seed's world: every second world is as its file says."""
    return "alike" if seed % 2 == 0 else DIFFERENCES[seed // 2 % len(DIFFERENCES)]


def draw_pair(seed: int, folder: Path, kind: str = "") -> Pair:
    """Draw a world and its file, and write both into a folder.

    Args:
        seed: Seed of the world.
        folder: Empty folder.
        kind: Difference; that of `kind_of` where it is empty.
    """
    random = np.random.default_rng((seed, 40))
    kind, file = kind or kind_of(seed), _draw(random)
    world = copy.deepcopy(file)
    _differ(world, kind, random)
    driven = copy.deepcopy(world)
    driven["episode"] = file["episode"]
    tasks = {}
    for name, content in (("file", file), ("recorded", world), ("driven", driven)):
        path = folder / name / f"{NAME}.yaml"
        path.parent.mkdir(parents=True)
        path.write_text(yaml.safe_dump(content, sort_keys=False))
        tasks[name] = load_navigation_task(path)
    return Pair(kind, folder / "file" / f"{NAME}.yaml", tasks["file"], tasks["recorded"], tasks["driven"])


def write_task(seed: int, folder: Path) -> Path:
    """Write the task file of a seed's world into a folder, named by the seed, and return it."""
    content = _draw(np.random.default_rng((seed, 40))) | {"name": f"{NAME}_{seed}"}
    file = folder / f"{NAME}_{seed}.yaml"
    folder.mkdir(parents=True, exist_ok=True)
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    return file


def _draw(random: np.random.Generator) -> dict[str, Any]:
    boxes = [_box(random) for _ in range(int(random.integers(7, 13)))]
    speed, turn = random.uniform(1.2, 2.0), random.uniform(0.5, 1.0)
    return {
        "name": NAME,
        "kind": "navigation",
        "about": "A car among boxes that a seed has drawn.",
        "source": "test/verdicts",
        "system": {
            "model": "dubins_car",
            "controls": {"v": "1.0 m/s", "omega": f"{-turn:.3f} .. {turn:.3f} rad/s"},
        },
        "robot": {
            "body": "turtlebot2",
            "commands": {"v": f"-0.5 .. {speed:.3f} m/s", "omega": f"{-turn:.3f} .. {turn:.3f} rad/s"},
        },
        "arena": {"x": "-4.5 .. 4.5 m", "y": "-4.5 .. 4.5 m", "wall_thickness": "0.2 m"},
        "start": {"x": "-3.5 .. -2.5 m", "y": "-3.5 .. -2.5 m", "theta": "0.0 .. 90.0 deg"},
        "goal": {"disc": {"centre": "(3.0, 3.0) m", "radius": "0.9 m"}},
        "obstacles": [{"box": _words(box)} for box in boxes],
        "episode": {"steps": 75, "time_step": "0.4 s"},
        "rewards": {"goal": 1000, "collision": -400, "timeout": -200},
        "lidar": {
            "beams": 16,
            "field": "-90.0 .. 90.0 deg",
            "placement": "centres",
            "range": "0.1 .. 10.0 m",
            "rate": "10.0 Hz",
        },
        "grid": {
            **{side: {"interval": "-4.5 .. 4.5 m", "count": 61} for side in ("x", "y")},
            "theta": {"interval": "-180.0 .. 180.0 deg", "count": 48},
        },
    }


def _box(random: np.random.Generator) -> dict[str, Any]:
    """Draw a box that leaves room at start and goal."""
    while True:
        centre, size = random.uniform(-3.6, 3.6, 2), random.uniform(0.5, 1.2, 2)
        if min(np.hypot(*(centre - _START)), np.hypot(*(centre - _GOAL))) > _ROOM + 0.6:
            return {"centre": centre, "size": size}


def _words(box: dict[str, Any]) -> dict[str, str]:
    return {key: f"({pair[0]:.3f}, {pair[1]:.3f}) m" for key, pair in box.items()}


def _numbers(text: str) -> np.ndarray:
    return np.array([float(part) for part in text.strip("() m").split(",")])


def _differ(world: dict[str, Any], kind: str, random: np.random.Generator) -> None:
    """Make a world different from its file in one way."""
    boxes = [{key: _numbers(text) for key, text in each["box"].items()} for each in world["obstacles"]]
    if kind in ("place", "one box"):
        moved = range(len(boxes)) if kind == "place" else [int(random.integers(len(boxes)))]
        for index in moved:
            angle, far = random.uniform(0.0, 2.0 * np.pi), random.uniform(0.1, 0.4)
            boxes[index]["centre"] = boxes[index]["centre"] + far * np.array((np.cos(angle), np.sin(angle)))
    elif kind == "size":
        for box in boxes:
            box["size"] = np.maximum(box["size"] + random.choice((-1.0, 1.0)) * random.uniform(0.1, 0.4, 2), 0.2)
    elif kind == "number":
        boxes = boxes[1:] if random.uniform() < 0.3 else [*boxes, _box(random)]
    elif kind == "period":
        world["episode"] = {"steps": 150, "time_step": "0.2 s"}
    elif kind == "delay":
        delay = random.uniform(0.1, 0.4)
        world["randomisation"] = {"command_delay": f"{delay:.3f} .. {delay:.3f} s"}
    elif kind == "lidar":
        changes = ({"noise": f"{random.uniform(0.02, 0.1):.3f} m"}, {"dropout": round(random.uniform(0.02, 0.1), 3)})
        world["lidar"] |= changes[int(random.integers(2))]
    elif kind == "movers":
        x, y = random.uniform(-1.5, 1.5, 2)
        ends = [f"({x - 1.5:.2f}, {y + 1.0:.2f}) m", f"({x + 1.5:.2f}, {y - 1.0:.2f}) m"]
        frames = [{"time": f"{8 * k}.0 s", "point": ends[k % 2]} for k in range(3)]  # through boxes, too
        world["movers"] = [{"radius": "0.25 m", "keyframes": {"frames": frames}}]
    world["obstacles"] = [{"box": _words(box)} for box in boxes]
