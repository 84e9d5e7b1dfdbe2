"""What learning goes on from: networks, optimisers and replay in one safetensors file, whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import torch
from ctrl_rl_core.whole_file import write_whole
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer

from ctrl_rl_training.errors import TrainingError

_HEADER_KEY = "checkpoint"
_REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_HISTORY = "history."


def write_checkpoint(path: Path, tensors: Mapping[str, NDArray[Any]], header: Mapping[str, Any]) -> None:
    """Write tensors and a JSON header; the file, replaced if it exists, is there whole or not at all."""
    content = save(
        {name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()},
        metadata={_HEADER_KEY: json.dumps(dict(header))},
    )
    write_whole(path, content)


def read_checkpoint(
    path: Path, take: Callable[[Mapping[str, Any], Mapping[str, NDArray[Any]]], None]
) -> dict[str, NDArray[Any]]:
    """Read what `write_checkpoint` wrote, hand header and tensors to `take`, and return the tensors.

    Raises:
        TrainingError: the file cannot be read, or `take` finds that it is of something else.
    """
    try:
        with safe_open(path, framework="np") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dictionary
            header = json.loads((file.metadata() or {})[_HEADER_KEY])
        take(header, tensors)
    except (OSError, SafetensorError, ValueError, KeyError, RuntimeError) as error:
        raise TrainingError(f"{path}: cannot go on from it ({error}); delete it to begin anew") from None
    return tensors


def tensors_of(
    networks: Mapping[str, torch.nn.Module], optimizers: Mapping[str, torch.optim.Optimizer]
) -> dict[str, NDArray[Any]]:
    """Return the state of networks and optimisers; the names of optimisers are without dots."""
    tensors: dict[str, NDArray[Any]] = {}
    for module, network in networks.items():
        tensors |= {f"{module}.{name}": tensor.cpu().numpy() for name, tensor in network.state_dict().items()}
    for name, optimizer in optimizers.items():
        for index, state in optimizer.state_dict()["state"].items():
            tensors |= {f"{name}.{index}.{key}": tensor.cpu().numpy() for key, tensor in state.items()}
    return tensors


def restore(
    tensors: Mapping[str, NDArray[Any]],
    networks: Mapping[str, torch.nn.Module],
    optimizers: Mapping[str, torch.optim.Optimizer],
) -> None:
    """Bring networks and optimisers to the state that `tensors_of` returned.

    Raises:
        RuntimeError: it is of other networks.
    """

    def part(prefix: str) -> dict[str, torch.Tensor]:
        return {
            name.removeprefix(prefix): torch.from_numpy(array.copy())
            for name, array in tensors.items()
            if name.startswith(prefix)
        }

    for module, network in networks.items():
        network.load_state_dict(part(f"{module}."))
    for name, optimizer in optimizers.items():
        state: dict[int, dict[str, torch.Tensor]] = {}
        for key, tensor in part(f"{name}.").items():
            index, _, field = key.partition(".")
            state.setdefault(int(index), {})[field] = tensor
        optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def save_checkpoint(
    path: Path, model: BaseAlgorithm, progress: Mapping[str, Any], history: Mapping[str, NDArray[Any]]
) -> None:
    """Write a checkpoint.

    Args:
        path: of the file; replaced if it exists.
        model: between two calls of its `learn`.
        progress: what else to go on with, as JSON.
        history: the same as arrays.
    """
    tensors = tensors_of(_networks(model), _optimizers(model))
    replay = _replay(model)
    if replay is not None:
        tensors |= {f"replay.{name}": getattr(replay, name)[: replay.pos] for name in _REPLAY}
    tensors |= {f"{_HISTORY}{name}": array for name, array in history.items()}
    write_checkpoint(path, tensors, {"samples": model.num_timesteps, "progress": dict(progress)})


def load_checkpoint(path: Path, model: BaseAlgorithm) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Bring a new model to where a checkpoint was and return progress and history.

    Raises:
        TrainingError: the file cannot be read, or is of another algorithm or network.
    """
    progress: dict[str, Any] = {}

    def take(header: Mapping[str, Any], tensors: Mapping[str, NDArray[Any]]) -> None:
        restore(tensors, _networks(model), _optimizers(model))
        _restore_replay(model, tensors)
        model.num_timesteps = header["samples"]
        progress.update(header["progress"])

    tensors = read_checkpoint(path, take)
    history = {name.removeprefix(_HISTORY): array for name, array in tensors.items() if name.startswith(_HISTORY)}
    return progress, history


def _restore_replay(model: BaseAlgorithm, tensors: Mapping[str, NDArray[Any]]) -> None:
    replay = _replay(model)
    if replay is not None:
        end = len(tensors["replay.rewards"])
        for name in _REPLAY:
            getattr(replay, name)[:end] = tensors[f"replay.{name}"]
        replay.pos = end


def _networks(model: BaseAlgorithm) -> dict[str, torch.nn.Module]:
    """Return the networks that the algorithm itself names as part of it."""
    return {path: getattr(model, path) for path in _parts(model) if not path.endswith("optimizer")}


def _optimizers(model: BaseAlgorithm) -> dict[str, torch.optim.Optimizer]:
    """Return its optimisers, by names without dots."""
    paths = [path for path in _parts(model) if path.endswith("optimizer")]
    return {path.removeprefix("policy.").replace(".", "_"): attrgetter(path)(model) for path in paths}


def _parts(model: BaseAlgorithm) -> list[str]:
    parts: list[str] = model._get_torch_save_params()[0]
    return parts


def _replay(model: BaseAlgorithm) -> ReplayBuffer | None:
    """Return the samples of earlier roll-outs that the algorithm still learns from."""
    return getattr(model, "replay_buffer", None)
