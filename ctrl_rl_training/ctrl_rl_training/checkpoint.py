"""What learning goes on from: networks, optimisers and whatever else in one safetensors file, whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from ctrl_rl_core.whole_file import write_whole
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ctrl_rl_training.errors import TrainingError

_HEADER_KEY = "checkpoint"


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
