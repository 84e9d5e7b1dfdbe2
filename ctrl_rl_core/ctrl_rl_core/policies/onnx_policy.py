"""Policies from elsewhere: an ONNX model and, beside it, the manifest as NAME.yaml. Needs onnxruntime."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.io.checked_yaml import read_yaml
from ctrl_rl_core.io.file_checks import one_line, raise_as, read_bytes
from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.policies.manifest import PolicyManifest
from ctrl_rl_core.policies.policy import NetworkPolicy, PolicyKind

LARGEST = 256_000_000
"""Bytes of a model."""
INSTALL = "python -m pip install -r requirements/onnx.txt"


def load_onnx_policy(path: Path) -> NetworkPolicy:
    """Return the policy of an ONNX model with one float32 input (1, n) and its outputs first.

    Raises:
        PolicyError: The model or its manifest is missing or wrong, or onnxruntime is not installed.
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
    session = _open(onnxruntime, content)
    given = session.get_inputs()
    if len(given) != 1 or given[0].type != "tensor(float)":
        kinds = ", ".join(f"{each.name}: {each.type}" for each in given)
        raise PolicyError(f"has the inputs {one_line(kinds, 100)}: one of type tensor(float) is taken")
    name = given[0].name

    def network(observation: NDArray[np.float32]) -> NDArray[np.float64]:
        try:
            outputs = np.asarray(session.run(None, {name: observation[None]})[0])
        except Exception as error:  # each of onnxruntime's own kinds
            raise PolicyError(f"the model fails: {one_line(error, 200)}") from None
        if outputs.size != manifest.action.outputs or outputs.dtype.kind != "f":
            raise PolicyError(
                f"the model gives {outputs.size} numbers of type {outputs.dtype}, its manifest wants "
                f"{manifest.action.outputs} real ones"
            )
        return outputs.reshape(-1).astype(np.float64)

    return NetworkPolicy(manifest, network, manifest.about or "an ONNX model")


def _open(onnxruntime: Any, content: bytes) -> Any:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1  # a robot's other nodes need the other cores
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # each of onnxruntime's own kinds
        raise PolicyError(f"is no ONNX model: {one_line(error, 200)}") from None


KIND = PolicyKind(load_onnx_policy)
