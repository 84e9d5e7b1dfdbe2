"""Small policies for tests: an actor that drives straight ahead, and its interface."""

from pathlib import Path
from typing import Any

import numpy as np

from ctrl_rl_core import Actor, PolicyManifest

DRIVE = {
    "robot": "differential_drive",
    "observation": [
        {"source": "scan", "count": 4, "step": 0.5 * np.pi, "low": 0.1, "high": 3.5},
        {"source": "odometry", "names": ["v", "omega"]},
    ],
    "action": {"low": [0.0, -1.0], "high": [0.2, 1.0]},
}
FLY = {
    "robot": "planar_quadrotor",
    "rest": [6.13, 6.13],
    "observation": [
        {"source": "odometry", "names": ["x", "v_x", "z", "v_z", "psi", "omega"]},
        {"source": "scan", "count": 4, "step": 0.5 * np.pi, "low": 0.1, "high": 10.0},
    ],
    "action": {"low": [5.0, 5.0], "high": [11.0, 11.0]},
}


def manifest(**changes: Any) -> PolicyManifest:
    """Return the interface of `DRIVE` with some keys changed."""
    return PolicyManifest.model_validate({**DRIVE, **changes})


def actor(interface: PolicyManifest, action: tuple[float, float] = (0.0, 0.0), **changes: Any) -> Actor:
    """Return an actor that always returns one action."""
    size = interface.size
    given = {
        "weights": (np.zeros((8, size), np.float32), np.zeros((2, 8), np.float32)),
        "biases": (np.zeros(8, np.float32), np.array(action, np.float32)),
        "activation": "tanh",
        "squashed": False,
        "middle": np.zeros(size, np.float32),
        "unit": np.ones(size, np.float32),
        "low": np.array(interface.action.low, np.float32),
        "high": np.array(interface.action.high, np.float32),
        "interface": interface,
    }
    return Actor(**{**given, **changes})


def write(folder: Path, name: str = "policy", action: tuple[float, float] = (0.0, 0.0), **changes: Any) -> Path:
    """Write such an actor and return its file."""
    file = folder / f"{name}.safetensors"
    actor(manifest(**changes), action).save(file)
    return file
