"""Checkpoints: networks, optimisers and replay buffer in one safetensors file, written atomically."""

from __future__ import annotations

from collections.abc import Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any

import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer

from ctrl_rl_learning.torch.checkpoints import Arrays, load_arrays, restore_state, save_arrays, state_arrays

_REPLAYED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_HISTORY, _VARIABLE, _REPLAY = "history.", "variable.", "replay."


def save_checkpoint(
    path: Path, model: BaseAlgorithm, progress: Mapping[str, Any], history: Mapping[str, NDArray[Any]]
) -> None:
    """Write a checkpoint.

    Args:
        path: Path of the file; replaced if it exists.
        model: Algorithm between two calls of its `learn`.
        progress: Progress of the run, as JSON.
        history: Visit counts of earlier iterations, as arrays.
    """
    tensors = model_arrays(model)
    tensors |= {f"{_HISTORY}{name}": array for name, array in history.items()}
    save_arrays(path, tensors, {"samples": model.num_timesteps, "progress": dict(progress)})


def load_checkpoint(path: Path, model: BaseAlgorithm) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Restore a new model from a checkpoint; return its progress and history.

    Raises:
        Exception: one of `ctrl_rl_learning.study.trainer.UNUSABLE`.
    """
    tensors, header = load_arrays(path)
    restore_model(model, tensors)
    model.num_timesteps = header["samples"]
    history = {name.removeprefix(_HISTORY): array for name, array in tensors.items() if name.startswith(_HISTORY)}
    return header["progress"], history


def model_arrays(model: BaseAlgorithm) -> Arrays:
    """Return networks, optimisers, single variables and replay buffer as arrays."""
    arrays = state_arrays(_networks(model), _optimizers(model))
    arrays |= {f"{_VARIABLE}{name}": value.detach().cpu().numpy() for name, value in _variables(model).items()}
    replay = _replay(model)
    if replay is not None:
        arrays |= {f"{_REPLAY}{name}": getattr(replay, name)[: replay.pos] for name in _REPLAYED}
    return arrays


def restore_model(model: BaseAlgorithm, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Restore a new model from the arrays of `model_arrays`.

    Raises:
        KeyError, RuntimeError: The arrays belong to another algorithm or network.
    """
    restore_state(_networks(model), _optimizers(model), arrays)
    for name, variable in _variables(model).items():
        variable.data.copy_(torch.from_numpy(arrays[f"{_VARIABLE}{name}"]))
    replay = _replay(model)
    if replay is not None:
        end = len(arrays[f"{_REPLAY}rewards"])
        for name in _REPLAYED:
            getattr(replay, name)[:end] = arrays[f"{_REPLAY}{name}"]
        replay.pos = end


def _networks(model: BaseAlgorithm) -> dict[str, torch.nn.Module]:
    """Return the networks that the algorithm lists as its own."""
    return {path: getattr(model, path) for path in _parts(model) if not path.endswith("optimizer")}


def _optimizers(model: BaseAlgorithm) -> dict[str, torch.optim.Optimizer]:
    """Return the algorithm's optimisers, by names without dots."""
    paths = [path for path in _parts(model) if path.endswith("optimizer")]
    return {path.removeprefix("policy.").replace(".", "_"): attrgetter(path)(model) for path in paths}


def _variables(model: BaseAlgorithm) -> dict[str, torch.Tensor]:
    """Return the learnt variables outside the networks."""
    return {name: attrgetter(name)(model) for name in model._get_torch_save_params()[1]}


def _parts(model: BaseAlgorithm) -> list[str]:
    parts: list[str] = model._get_torch_save_params()[0]
    return parts


def _replay(model: BaseAlgorithm) -> ReplayBuffer | None:
    """Return the algorithm's replay buffer; None if it has none."""
    return getattr(model, "replay_buffer", None)
