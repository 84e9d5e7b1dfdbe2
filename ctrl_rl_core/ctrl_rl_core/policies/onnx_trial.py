"""Loads and tries an ONNX model from standard input in a separate process: `python -m ... SIZE MEMORY`."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from ctrl_rl_core.io.file_checks import one_line
from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.processes.limited import limit_memory

_TRIED = (0.0, 1.0, -1.0, 1e6)


def open_model(onnxruntime: Any, content: bytes) -> Any:
    """Open an inference session for a model with one float32 input.

    Raises:
        PolicyError: The content is not such a model.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1  # leave the other cores to the robot's other nodes
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # any of onnxruntime's error types
        if "external" in str(error).lower():
            raise PolicyError("stores its weights in another file: save model and weights together") from None
        raise PolicyError(f"is no ONNX model: {one_line(error, 200)}") from None
    given = session.get_inputs()
    if len(given) != 1 or given[0].type != "tensor(float)":
        kinds = ", ".join(f"{each.name}: {each.type}" for each in given)
        raise PolicyError(f"has the inputs {one_line(kinds, 100)}: one of type tensor(float) is taken")
    return session


def run_model(session: Any, observation: Any) -> list[Any]:
    """Return the outputs (1, ...) of a model for an observation (n,).

    Raises:
        PolicyError: The model fails.
    """
    try:
        return [np.asarray(each) for each in session.run(None, {session.get_inputs()[0].name: observation[None]})]
    except Exception as error:  # any of onnxruntime's error types
        raise PolicyError(f"the model fails: {one_line(error, 200)}") from None


def main() -> int:
    """Load the model, run it a few times, and return 0 if it answers."""
    import onnxruntime

    limit_memory(int(sys.argv[2]))
    try:
        session = open_model(onnxruntime, sys.stdin.buffer.read())
        for value in _TRIED:
            run_model(session, np.full(int(sys.argv[1]), value, np.float32))
    except PolicyError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
