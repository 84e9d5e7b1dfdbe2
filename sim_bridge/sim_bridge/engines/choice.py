"""Selection of the physics engine."""

from __future__ import annotations

import functools
import logging
from importlib.util import find_spec

from sim_bridge.engines.engine import Engine
from sim_bridge.errors import SimulationError

ENGINES = ("auto", "pybullet", "mujoco", "planar")
"""Engine names; "auto" is PyBullet if installed, else MuJoCo. "planar" needs neither."""


@functools.cache
def default_engine() -> str:
    """Return the engine that "auto" selects; if PyBullet is missing, print one line, once."""
    if find_spec("pybullet") is not None:
        return "pybullet"
    logging.getLogger("sim_bridge").warning("PyBullet is not installed: the simulation runs in MuJoCo")
    return "mujoco"


def make_engine(name: str, rate: int, gui: bool = False) -> Engine:
    """Create an engine by its name in `ENGINES`.

    Args:
        name: Name of the engine.
        rate: Physics steps per second [Hz].
        gui: Whether to show the world in a window (PyBullet only).

    Raises:
        SimulationError: The engine is unknown, not installed, or has no window.
    """
    if name not in ENGINES:
        raise SimulationError(f"there is no engine '{name}': choose one of {', '.join(ENGINES)}")
    name = default_engine() if name == "auto" else name
    if gui and name != "pybullet":
        raise SimulationError(f"engine '{name}' has no window here: run with gui false, or with engine pybullet")
    if name == "planar":
        from sim_bridge.engines.planar_engine import PlanarEngine

        return PlanarEngine(rate)
    if find_spec(name) is None:
        raise SimulationError(f"engine '{name}' is not installed: install {name}, or run with engine auto")
    if name == "pybullet":
        from sim_bridge.engines.pybullet_engine import PybulletEngine

        return PybulletEngine(rate, gui)
    from sim_bridge.engines.mujoco_engine import MujocoEngine

    return MujocoEngine(rate)
