"""What a run goes on from: networks, optimisers and replay in one safetensors file, whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ctrl_rl_training.io.array_file import load_arrays, save_arrays
from ctrl_rl_training.io.learner_state import restore_state, state_arrays

from option_coordinator.training.learners.learner import Learner

_MEMORY = "memory."


def save_checkpoint(path: Path, learner: Learner, progress: Mapping[str, Any]) -> None:
    """Write a checkpoint; `progress` is what else to go on with, as JSON."""
    arrays = state_arrays(learner.networks(), learner.optimizers())
    arrays |= {f"{_MEMORY}{name}": array for name, array in learner.memory().items()}
    save_arrays(path, arrays, progress)


def load_checkpoint(path: Path, learner: Learner) -> dict[str, Any]:
    """Bring a new learner to where a checkpoint was and return the progress.

    Raises:
        Exception: one of `ctrl_rl_training.experiments.trainer.UNUSABLE`.
    """
    arrays, progress = load_arrays(path)
    restore_state(learner.networks(), learner.optimizers(), arrays)
    learner.recall({name.removeprefix(_MEMORY): a for name, a in arrays.items() if name.startswith(_MEMORY)})
    return progress
