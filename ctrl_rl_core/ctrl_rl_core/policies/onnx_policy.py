"""Third-party policies: an ONNX model with a manifest NAME.yaml beside it. Needs onnxruntime."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.io.checked_yaml import read_yaml
from ctrl_rl_core.io.file_checks import raise_as, read_bytes
from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.policies.manifest import PolicyManifest
from ctrl_rl_core.policies.onnx_trial import open_model, run_model
from ctrl_rl_core.policies.policy import NetworkPolicy, PolicyKind
from ctrl_rl_core.processes.limited import LimitError, run_limited

LARGEST = 256_000_000
"""Maximum size of a model [bytes]."""
MEMORY, TIME = 1 << 30, 20.0
"""Memory limit beyond eight times the model's size [bytes], and time limit [s], of the trial run."""
INSTALL = "python -m pip install -r requirements/onnx.txt"


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
    try:
        import onnxruntime
    except ImportError:
        raise PolicyError(f"needs the package 'onnxruntime', which is not installed: {INSTALL}") from None
    try:
        # A hostile model could keep this process busy beyond any signal, or exhaust memory: it is tried in another one.
        run_limited("ctrl_rl_core.policies.onnx_trial", [str(manifest.size)], content, TIME, MEMORY + 8 * len(content))
    except LimitError as error:
        raise PolicyError(str(error)) from None
    session = open_model(onnxruntime, content)

    def network(observation: NDArray[np.float32]) -> NDArray[np.float64]:
        outputs = run_model(session, observation)
        if outputs.size != manifest.action.outputs or outputs.dtype.kind != "f":
            raise PolicyError(
                f"the model gives {outputs.size} numbers of type {outputs.dtype}, its manifest wants "
                f"{manifest.action.outputs} real ones"
            )
        return outputs.reshape(-1).astype(np.float64)

    return NetworkPolicy(manifest, network, manifest.about or "an ONNX model")


KIND = PolicyKind(load_onnx_policy)
