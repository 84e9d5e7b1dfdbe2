"""Atomic files of named arrays, and the state of networks and optimisers as such arrays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from ctrl_rl_core.io import TYPES, encode_tensors, read_tensors
from numpy.typing import NDArray

from ctrl_rl_core import atomic_write
from ctrl_rl_learning.errors import LearningError

_HEADER_KEY = "checkpoint"


def save_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], header: Mapping[str, Any]) -> None:
    """Write arrays and a JSON header to a file."""
    atomic_write(path, encode_tensors(arrays, _HEADER_KEY, header))


def load_arrays(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return the arrays and the header of a file.

    Raises:
        FileError, ValidationError, OSError: `save_arrays` did not write the file, or it is damaged; see
            `file_checks.raise_as`.
    """
    header, arrays, _ = read_tensors(path, _HEADER_KEY, largest=None, types=tuple(TYPES))
    return arrays, header


Arrays = dict[str, NDArray[Any]]


def state_arrays(networks: Mapping[str, torch.nn.Module], optimizers: Mapping[str, torch.optim.Optimizer]) -> Arrays:
    """Return the state of networks and optimisers as arrays; optimiser names must not contain dots.

    Raises:
        LearningError: A weight is not finite.
    """
    arrays: Arrays = {}
    for prefix, network in networks.items():
        weights = {f"{prefix}.{name}": tensor.cpu().numpy() for name, tensor in network.state_dict().items()}
        for name, weight in weights.items():
            if weight.dtype.kind == "f" and not np.isfinite(weight).all():
                raise LearningError(
                    f"training has diverged: weights {name} are not finite. The last checkpoint is still good; check "
                    "rewards and observations, or lower the learning rate"
                )
        arrays |= weights
    for prefix, optimizer in optimizers.items():
        for index, state in optimizer.state_dict()["state"].items():
            arrays |= {f"{prefix}.{index}.{key}": tensor.cpu().numpy() for key, tensor in state.items()}
    return arrays


def restore_state(
    networks: Mapping[str, torch.nn.Module],
    optimizers: Mapping[str, torch.optim.Optimizer],
    arrays: Mapping[str, NDArray[Any]],
) -> None:
    """Restore networks and optimisers from the arrays of `state_arrays`.

    Raises:
        RuntimeError: The arrays belong to other networks.
    """
    for prefix, network in networks.items():
        network.load_state_dict(_part(arrays, f"{prefix}."))
    for prefix, optimizer in optimizers.items():
        state: dict[int, dict[str, torch.Tensor]] = {}
        for key, tensor in _part(arrays, f"{prefix}.").items():
            index, _, field = key.partition(".")
            state.setdefault(int(index), {})[field] = tensor
        optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def _part(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, torch.Tensor]:
    return {
        name.removeprefix(prefix): torch.from_numpy(array.copy())
        for name, array in arrays.items()
        if name.startswith(prefix)
    }
