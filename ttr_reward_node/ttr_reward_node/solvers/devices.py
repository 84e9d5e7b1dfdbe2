"""Devices for the semi-Lagrangian sweeps: the CPU with Numba, a GPU with NVIDIA Warp."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.kernels.stencil import Grid, StepTable
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.solvers.near_nodes import find_near_nodes, near_share
from ttr_reward_node.solvers.solution import gigabytes
from ttr_reward_node.solvers.steps import Layout, Steps
from ttr_reward_node.solvers.sweeper import Sweeper, make_sweeper

CPU = "cpu"
"""Default device, compiled by Numba; the reference for all others."""
_ON_GPU = 13.0, 8.0, 5e8  # bytes per node (two buffers, choice, flag); per step without its moves; for the rest
_MOST_NODES = 2**31 - 1  # node indices have 32 bits

MakeSweeper = Callable[[TimeToReachProblem, Layout, Steps, NDArray[np.uint8], StepTable, Grid, float], Sweeper]


def find_device(device: str) -> MakeSweeper:
    """Return the factory of sweepers for a device.

    Args:
        device: "cpu"; "cuda" or "cuda:N" for a GPU; or "warp:cpu", the GPU's kernels on the CPU, slow, for tests.

    Raises:
        TimeToReachError: There is no such device, or Warp is not installed; the message states the remedy.
    """
    if device == CPU:
        return _on_cpu
    if not re.fullmatch(r"cuda(:\d+)?|warp:cpu", device):
        raise TimeToReachError(f"unknown device '{device}': take cpu, cuda or cuda:N, or warp:cpu")
    if device == "warp:cpu":
        _import_warp(device)
        return partial(_on_warp, "cpu")
    # Suppress Warp's own warning about a missing driver.
    gpus = _import_warp(device).get_cuda_device_count() if _driver_is_there() else 0
    number = int(device.partition(":")[2] or 0)
    if number >= gpus:
        raise TimeToReachError(f"device '{device}': {gpus} NVIDIA GPUs with a driver are here; take --device cpu")
    return partial(_on_warp, f"cuda:{number}")


def _driver_is_there() -> bool:
    try:
        ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False
    return True


def _import_warp(device: str) -> Any:
    try:
        import warp
    except ImportError:
        raise TimeToReachError(
            f"device '{device}' needs NVIDIA Warp, which is not installed: pip install warp-lang"
        ) from None
    warp.config.log_level = warp.LOG_ERROR  # no banner in a command's output
    warp.init()
    return warp


def _on_cpu(
    problem: TimeToReachProblem,
    layout: Layout,
    steps: Steps,
    flags: NDArray[np.uint8],
    table: StepTable,
    grid: Grid,
    rate: float,
) -> Sweeper:
    return make_sweeper(layout, grid, table, find_near_nodes(problem, layout, steps, flags, table, grid, rate))


def _on_warp(
    name: str,
    problem: TimeToReachProblem,
    layout: Layout,
    steps: Steps,
    flags: NDArray[np.uint8],
    table: StepTable,
    grid: Grid,
    rate: float,
) -> Sweeper:
    from ttr_reward_node.solvers.warp_near_nodes import BLOCK, OutcomeFinder
    from ttr_reward_node.solvers.warp_sweeper import WarpSweeper, free_memory

    if problem.points > _MOST_NODES:
        raise TimeToReachError(f"{problem.points:,} grid points: a GPU takes {_MOST_NODES:,} at most, or --device cpu")
    of_node, of_step, rest = _ON_GPU
    outcomes = 4.0 * near_share(problem, float(steps.lengths.max())) * problem.points * steps.codes.shape[1]
    needed = of_node * problem.points + (of_step + 2.0 * len(layout.order)) * steps.codes.size + outcomes + rest
    if needed > (there := free_memory(name)):
        raise TimeToReachError(
            f"{problem.points:,} grid points need {gigabytes(needed)} of the GPU's memory at most, {gigabytes(there)} "
            "are free: take fewer points on some axes (counts), or --device cpu"
        )
    near = find_near_nodes(problem, layout, steps, flags, table, grid, rate, OutcomeFinder(name), BLOCK)
    return WarpSweeper(name, grid, table, near)
