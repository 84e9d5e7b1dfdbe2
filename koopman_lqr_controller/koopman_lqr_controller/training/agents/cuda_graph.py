"""Functions that a GPU repeats as a CUDA graph: launching their kernels one by one takes longer than running them."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

_EAGER_CALLS = 3
"""Calls before one is recorded; libraries make their workspaces in them."""


class Graphed:
    """A function of tensors that always does the same steps, whatever the numbers in them.

    It draws no random numbers, and what it changes it changes in place. Shapes are those of the first call.

    Args:
        function: Takes tensors of the device and returns one.
        device: Device; on a CPU the function is called as it is.
    """

    def __init__(self, function: Callable[..., Tensor], device: torch.device) -> None:
        self._function, self._device, self._calls = function, device, 0
        self._graph: torch.cuda.CUDAGraph | None = None

    def __call__(self, *given: Tensor) -> Tensor:
        """Return what the function does, for tensors of any device; on a GPU the next call writes over it."""
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
        """Call the function on a stream of its own, as it is when it is recorded."""
        stream, now = torch.cuda.Stream(), torch.cuda.current_stream()  # type: ignore[no-untyped-call]
        stream.wait_stream(now)
        with torch.cuda.stream(stream):
            answer = self._function(*given)
        now.wait_stream(stream)
        return answer
