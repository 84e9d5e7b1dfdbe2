"""Third-party policies: an ONNX model with a manifest NAME.yaml beside it. Needs onnxruntime."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.io.checked_yaml import read_yaml
from ctrl_rl_core.io.file_checks import raise_as, read_bytes
from ctrl_rl_core.networks.onnx_writer import INSTALL
from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.policies.manifest import PolicyManifest
from ctrl_rl_core.policies.onnx_trial import open_model, run_model
from ctrl_rl_core.policies.policy import NetworkPolicy, PolicyKind
from ctrl_rl_core.processes.limited import LimitError, run_limited

LARGEST = 256_000_000
"""Maximum size of a model [bytes]."""
MEMORY, TIME = 1 << 30, 20.0
"""Memory limit beyond eight times the model's size [bytes], and time limit [s], of the trial run."""


def load_onnx_policy(path: Path) -> NetworkPolicy:
    """Load the policy of an ONNX model with one float32 input (1, n), whose first output holds the network outputs.

    Raises:
        PolicyError: The model or its manifest is missing or invalid, or onnxruntime is not installed.
    """
    beside = path.with_suffix(".yaml")
    with raise_as(PolicyError, path):
        content = read_bytes(path, LARGEST)
    with raise_as(PolicyError, beside, "an ONNX policy needs its manifest there, see docs/howto/any_policy.md"):
        manifest = PolicyManifest.model_validate(read_yaml(beside))
    session = open_checked(content, manifest.size)

    def network(observation: NDArray[np.float32]) -> NDArray[np.float64]:
        outputs, *others = run_model(session, observation)
        if manifest.largest_distance is not None:
            _check_distance(others, manifest.largest_distance)
        if outputs.size != manifest.action.outputs or outputs.dtype.kind != "f":
            raise PolicyError(
                f"the model gives {outputs.size} numbers of type {outputs.dtype}, its manifest wants "
                f"{manifest.action.outputs} real ones"
            )
        return outputs.reshape(-1).astype(np.float64)

    return NetworkPolicy(manifest, network, manifest.about.rstrip(".") or "an ONNX model")


def open_checked(content: bytes, size: int) -> Any:
    """Try a model in a process with limited memory and time, then open a session for it here.

    Args:
        content: The model.
        size: Size of the observation.

    Raises:
        PolicyError: It is no model with one float32 input (1, size), or onnxruntime is not installed.
    """
    try:
        import onnxruntime
    except ImportError:
        raise PolicyError(f"needs the package 'onnxruntime', which is not installed: {INSTALL}") from None
    try:
        # A hostile model could keep this process busy beyond any signal, or exhaust memory: it is tried in another one.
        run_limited("ctrl_rl_core.policies.onnx_trial", [str(size)], content, TIME, MEMORY + 8 * len(content))
    except LimitError as error:
        raise PolicyError(str(error)) from None
    return open_model(onnxruntime, content)


def _check_distance(outputs: Sequence[NDArray[Any]], largest: float) -> None:
    """Raise if the second output of a model says that the observation is far from training.

    Raises:
        PolicyError: It is, or there is no such output.
    """
    if not outputs or outputs[0].size != 1:
        raise PolicyError("its manifest has largest_distance, but the model gives no distance as its second output")
    if not float(outputs[0].item()) <= largest:
        raise PolicyError("the observation has left the region seen in training")


KIND = PolicyKind(load_onnx_policy)
