"""A task to learn: its environments, suitable settings, and the thesis's return. Imports no torch."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ctrl_rl_core import load_navigation_task, task_digest
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.settings import Settings

AnyEnvironment = Any
"""A gymnasium.Env; the package is imported only when one is created."""


@dataclass(frozen=True)
class BenchmarkTask:
    """A task to learn.

    Attributes:
        name: Name of the task.
        about: Description in one line.
        make: Creates an environment for training (True) or evaluation (False).
        settings: Training settings.
        repeat: Number of simulation steps per action.
        chunk: Number of actions between two evaluations; whole episodes if they have a fixed length.
        chunks: Default number of chunks.
        evaluations: Number of episodes per evaluation.
        chunk_episodes: Number of episodes after which a chunk ends early; 0 for no limit.
        episodes: Maximum number of training episodes, including those that end with a chunk; 0 for no limit.
        patience: Number of chunks without a new best after which training ends; 0 for no limit.
        goal: Observation of the goal; None for z_ref = 0.
        middle: Value of the observation that maps to 0 in the encoder.
        unit: Distance from `middle` that maps to 1.
        thesis: Return reported in the thesis, or None.
        task: Name or file of a task with a corridor; empty for tasks of other kinds.
        version: Version of the environment's observations and rewards; increased with each change of them.
    """

    name: str
    about: str
    make: Callable[[bool], AnyEnvironment]
    settings: Settings
    repeat: int
    chunk: int
    chunks: int
    evaluations: int = 5
    chunk_episodes: int = 0
    episodes: int = 0
    patience: int = 0
    goal: tuple[float, ...] | None = None
    middle: float = 0.0
    unit: float = 1.0
    thesis: float | None = None
    task: str = ""
    version: int = 1

    @property
    def title(self) -> str:
        """Name for files and tables."""
        return title_of(self.name)

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the task's definition, independent of the training duration."""
        task = task_digest(load_navigation_task(self.task)) if self.task else None
        parts = [self.title, self.version, self.repeat, self.goal, self.middle, self.unit, task]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()

    def with_settings(self, **changes: Any) -> BenchmarkTask:
        """Return the task with other settings.

        Raises:
            KoopmanError: A setting is unknown or out of range.
        """
        try:
            settings = replace(self.settings, **changes)
        except TypeError:
            unknown = set(changes) - set(self.settings.as_json())
            known = ", ".join(self.settings.as_json())
            raise KoopmanError(f"no setting {', '.join(sorted(unknown))}: there are {known}") from None
        if bool(settings.crop) != bool(self.settings.crop):
            must = "positive, this task shows pictures" if self.settings.crop else "0, this task shows none"
            raise KoopmanError(f"crop is {settings.crop}: must be {must}")
        return replace(self, settings=settings)


def title_of(name: str) -> str:
    """Return a task's name for use in file names: no folders, only letters, digits, ".", "@", "_" and "-"."""
    if name.endswith(".yaml"):
        return Path(name).stem
    short = re.sub(r"^(suite|gym):|^file:.*/", "", name)
    return re.sub(r"[^A-Za-z0-9_.@-]+", "_", short)
