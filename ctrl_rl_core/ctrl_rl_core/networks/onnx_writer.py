"""Writes a network as an ONNX model. Needs the package `onnx`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.networks.layers import (
    Clip,
    Dense,
    Layer,
    Length,
    LogSoftmax,
    Nearness,
    Network,
    Normalise,
    Pointwise,
    Prepend,
    Scale,
    Table,
)

OPSET, IR_VERSION = 17, 8
"""Versions that runtimes of 2022 and later read; 17 is the first with LayerNormalization."""
INSTALL = "python -m pip install -r requirements/onnx.txt"


class NetworkError(CtrlRlError):
    """A network cannot be written; the message gives the reason."""


def to_onnx(network: Network, name: str, about: Mapping[str, str]) -> bytes:
    """Return the model (bytes): input "observation" (batch, size), an output (batch, ...) for each head; float32.

    Args:
        network: Network to write.
        name: Name of the graph.
        about: Metadata of the model.

    Raises:
        NetworkError: A layer has no ONNX operators, or the package `onnx` is not installed.
    """
    try:
        import onnx
    except ImportError:
        raise NetworkError(f"needs the package 'onnx', which is not installed: {INSTALL}") from None
    graph = _Graph(onnx)
    number = onnx.TensorProto.FLOAT
    end = graph.add_layers("observation", network.trunk)
    for head, layers in network.heads.items():
        graph.add("Identity", [graph.add_layers(end, layers)], output=head)
    inputs = [onnx.helper.make_tensor_value_info("observation", number, ["batch", network.size])]
    outputs = [onnx.helper.make_tensor_value_info(head, number, None) for head in network.heads]
    whole = onnx.helper.make_graph(graph.nodes, name, inputs, outputs, graph.constants)
    model = onnx.helper.make_model(
        whole,
        producer_name="ctrl_rl",
        ir_version=IR_VERSION,
        opset_imports=[onnx.helper.make_opsetid("", OPSET)],
    )
    onnx.helper.set_model_props(model, dict(about))
    model = onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True)
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString(deterministic=True))


class _Graph:
    """Nodes and constants of the model so far; each value has a name."""

    def __init__(self, onnx: Any) -> None:
        self._onnx = onnx
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def add(self, operator: str, inputs: Sequence[str], output: str = "", **attributes: Any) -> str:
        """Add an operator and return the name of its output."""
        name = output or f"{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(self._onnx.helper.make_node(operator, inputs, [name], **attributes))
        return name

    def constant(self, values: Any, kind: Any = np.float32) -> str:
        """Add a constant and return its name."""
        name = f"constant_{len(self.constants)}"
        array = np.ascontiguousarray(values, dtype=kind)
        self.constants.append(self._onnx.numpy_helper.from_array(array, name))
        return name

    def add_layers(self, value: str, layers: Sequence[Layer]) -> str:
        """Add layers one after the other and return the name of the last output.

        Raises:
            NetworkError: A layer has no ONNX operators.
        """
        for layer in layers:
            write = _OPERATORS.get(type(layer))
            if write is None:
                raise NetworkError(f"has a layer without ONNX operators: {type(layer).__name__}")
            value = write(self, value, layer)
        return value


def _scale(graph: _Graph, value: str, layer: Scale) -> str:
    return graph.add("Div", [graph.add("Sub", [value, graph.constant(layer.middle)]), graph.constant(layer.unit)])


def _dense(graph: _Graph, value: str, layer: Dense) -> str:
    return graph.add("Gemm", [value, graph.constant(layer.weight), graph.constant(layer.bias)], transB=1)


def _pointwise(graph: _Graph, value: str, layer: Pointwise) -> str:
    return graph.add({"tanh": "Tanh", "relu": "Relu"}[layer.function], [value])


def _clip(graph: _Graph, value: str, layer: Clip) -> str:
    return graph.add("Clip", [value, graph.constant(layer.low), graph.constant(layer.high)])


def _normalise(graph: _Graph, value: str, layer: Normalise) -> str:
    parts = [value, graph.constant(layer.weight), graph.constant(layer.bias)]
    return graph.add("LayerNormalization", parts, axis=-1, epsilon=layer.epsilon)


def _nearness(graph: _Graph, value: str, layer: Nearness) -> str:
    begin, middle, end, axis = (graph.constant([place], np.int64) for place in (0, layer.count, 2**31 - 1, 1))
    distances = graph.add("Slice", [value, begin, middle, axis])
    others = graph.add("Slice", [value, middle, end, axis])
    return graph.add("Concat", [graph.add("Div", [graph.constant(layer.near), distances]), others], axis=1)


def _length(graph: _Graph, value: str, _layer: Length) -> str:
    return graph.add("ReduceL2", [value], axes=[1], keepdims=1)


def _prepend(graph: _Graph, value: str, layer: Prepend) -> str:
    return graph.add("Concat", [value, graph.add_layers(value, layer.layers)], axis=1)


def _table(graph: _Graph, value: str, layer: Table) -> str:
    # A 0 keeps that dimension, here the batch.
    return graph.add("Reshape", [value, graph.constant([0, *layer.shape], np.int64)])


def _log_softmax(graph: _Graph, value: str, layer: LogSoftmax) -> str:
    return graph.add("LogSoftmax", [value], axis=layer.axis)


_OPERATORS: Mapping[type, Callable[[_Graph, str, Any], str]] = {
    Scale: _scale,
    Dense: _dense,
    Pointwise: _pointwise,
    Clip: _clip,
    Normalise: _normalise,
    Nearness: _nearness,
    Length: _length,
    Prepend: _prepend,
    Table: _table,
    LogSoftmax: _log_softmax,
}
