"""What a run goes on from: networks, optimisers and replay in one safetensors file, whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ctrl_rl_learning.torch.array_file import load_arrays, save_arrays
from ctrl_rl_learning.torch.learner_state import restore_state, state_arrays

from option_coordinator.training.learners.learner import Learner

_MEMORY = "memory."


class Checkpoints:
    """The part of a `Learning` that saves and loads its learner."""

    _learner: Learner

    def save(self, path: Path, progress: Mapping[str, Any], /) -> None:
        """Write a checkpoint; `progress` is what else to go on with, as JSON."""
        arrays = state_arrays(self._learner.networks, self._learner.optimizers)
        arrays |= {f"{_MEMORY}{name}": array for name, array in self._learner.memory().items()}
        save_arrays(path, arrays, progress)

    def load(self, path: Path, /) -> dict[str, Any]:
        """Bring the new learner to where a checkpoint was and return the progress.

        Raises:
            Exception: one of `ctrl_rl_learning.study.trainer.UNUSABLE`.
        """
        arrays, progress = load_arrays(path)
        restore_state(self._learner.networks, self._learner.optimizers, arrays)
        self._learner.recall({n.removeprefix(_MEMORY): a for n, a in arrays.items() if n.startswith(_MEMORY)})
        return progress
