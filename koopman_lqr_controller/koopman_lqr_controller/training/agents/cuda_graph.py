"""Runs repeated GPU functions as CUDA graphs, because launching single kernels takes longer than running them."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

_EAGER_CALLS = 3
"""Number of calls before a graph is recorded, in which libraries allocate their workspaces."""


class Graphed:
    """A function of tensors that always performs the same operations, regardless of their values.

    The function must not draw random numbers, and must modify tensors in place. Shapes are those of the first call.

    Args:
        function: Function from tensors on the device to a tensor.
        device: Device; on a CPU, the function is called directly.
    """

    def __init__(self, function: Callable[..., Tensor], device: torch.device) -> None:
        self._function, self._device, self._calls = function, device, 0
        self._graph: torch.cuda.CUDAGraph | None = None

    def __call__(self, *given: Tensor) -> Tensor:
        """Return the function's result for tensors on any device; on a GPU, the next call overwrites it."""
        if self._device.type == "cpu":
            return self._function(*given)
        if self._graph is None and self._calls < _EAGER_CALLS:
            self._calls += 1
            return self._beside(*(tensor.to(self._device) for tensor in given))
        if self._graph is None:
            self._given = [tensor.to(self._device).clone() for tensor in given]
            self._graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(self._graph, capture_error_mode="thread_local"):
                self._answer = self._function(*self._given)
        for kept, tensor in zip(self._given, given, strict=True):
            kept.copy_(tensor)
        self._graph.replay()
        return self._answer

    def _beside(self, *given: Tensor) -> Tensor:
        """Call the function on a separate stream, as during recording."""
        stream, now = torch.cuda.Stream(), torch.cuda.current_stream()  # type: ignore[no-untyped-call]
        stream.wait_stream(now)
        with torch.cuda.stream(stream):
            answer = self._function(*given)
        now.wait_stream(stream)
        return answer
