from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ctrl_rl_core import NavigationTask, load_navigation_task
from sim_bridge import ENGINES, SimulatedWorld, SimulationOptions

ROOM = """
name: room
kind: navigation
about: A burger in an empty room of 4 m x 3 m.
source: tests
system: {model: dubins_car}
robot:
  body: turtlebot3_burger
  commands: {v: -0.22 .. 0.22 m/s, omega: -2.84 .. 2.84 rad/s}
arena: {x: -2.0 .. 2.0 m, y: -1.5 .. 1.5 m, wall_thickness: 0.2 m}
start: {x: START_X m, y: 0.0 m, theta: START_THETA rad}
goal: {x: 100.0 m}
OBSTACLES
MOVERS
episode: {steps: 100000, time_step: 0.2 s}
rewards: {goal: 1, collision: -1}
lidar: {beams: 360, field: 0.0 .. 360.0 deg, range: 0.12 .. 3.5 m, rate: 5.0 Hz}
"""


@pytest.fixture
def make_room(tmp_path: Path):
    """Return a function that creates the room as a task, with start x and heading, obstacles and movers as YAML."""

    def make(x: float = 0.0, theta: float = 0.0, obstacles: str = "", movers: str = "") -> NavigationTask:
        text = ROOM.replace("START_X", str(x)).replace("START_THETA", str(theta))
        text = text.replace("OBSTACLES", f"obstacles: {obstacles}" if obstacles else "")
        text = text.replace("MOVERS", f"movers: {movers}" if movers else "")
        file = tmp_path / "room.yaml"
        file.write_text(text)
        return load_navigation_task(file)

    return make


@pytest.fixture(params=[name for name in ENGINES if name not in ("auto", "planar")])
def engine(request: pytest.FixtureRequest) -> str:
    """Each installed engine with contact forces; see test_planar_engine.py for the one without."""
    name: str = request.param
    pytest.importorskip(name)
    return name


@pytest.fixture
def simulate(engine: str) -> Iterator[Callable[..., SimulatedWorld]]:
    """Return a function that simulates a task, or one of the suite by name, with simulation options."""
    worlds = []

    def make(
        task: NavigationTask | str, seed: int = 0, robots: int = 1, width: float | None = None, **options: Any
    ) -> SimulatedWorld:
        known = load_navigation_task(task) if isinstance(task, str) else task
        settings = SimulationOptions(**{"engine": engine, **options})
        worlds.append(SimulatedWorld(known, seed, robots, width, settings))
        return worlds[-1]

    yield make
    for world in worlds:
        world.close()
