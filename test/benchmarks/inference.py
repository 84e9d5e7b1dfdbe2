"""From a scan's ranges to a command, without ROS: both kinds of policy, both lidars of the TurtleBot3.

First what resamples the scan, then all of it. Beside the floor: the matrix products alone that the policy cannot do
without, in the same loop. Percentiles are those of 1000 scans, in the median of ten such stretches: a machine that
others share interrupts whatever runs on it, at times often.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from _common import Row, row

from ctrl_rl_core import ScanGeometry
from koopman_lqr_controller import DEFAULT_POLICY, EdmdPolicy, KoopmanPolicy, LatentPolicy, find_policy, load_policy

STRETCH = 1000
STRETCHES = 10
WARM_UP = 2000


def products(policy: KoopmanPolicy) -> Callable[[], None]:
    """Return what multiplies by each matrix of a policy once."""
    if isinstance(policy, EdmdPolicy):
        matrices = [policy.K]
    else:
        assert isinstance(policy, LatentPolicy)
        controller = policy.controller
        matrices = [it.weight for it in controller.encoder.layers if getattr(it, "weight", np.empty(0)).ndim == 2]
        matrices += [each for each in (controller.projection, controller.K) if each is not None]
    work = [(matrix, np.ones(matrix.shape[1], matrix.dtype)) for matrix in matrices]

    def multiply() -> None:
        for matrix, vector in work:
            matrix.dot(vector)

    return multiply


def scans(lidar: str) -> list[tuple[np.ndarray, ScanGeometry]]:
    """Return scans: of an LDS-01 all alike but for its zeros, of an LDS-02 each of another count, with NaN."""
    random = np.random.default_rng(1)
    out = []
    for _ in range(WARM_UP + STRETCHES * STRETCH):
        count = random.uniform(267.0, 274.0) if lidar == "LDS-02" else 360.0
        ranges = random.uniform(0.2, 3.4, int(np.ceil(count))).astype(np.float32)
        ranges[random.random(len(ranges)) < 0.1] = np.nan if lidar == "LDS-02" else 0.0
        measures = (0.0, 100.0) if lidar == "LDS-02" else (0.12, 3.5)
        out.append((ranges, ScanGeometry(len(ranges), 0.0, 2.0 * np.pi / count, *measures)))
    return out


def rows() -> list[Row]:
    """Return median and 99th percentile of each policy with each lidar."""
    out: list[Row] = []
    policies = {"EDMD": "curved_corridor_edmd", "learnt": DEFAULT_POLICY}
    for name, shipped in policies.items():
        policy = load_policy(find_policy(shipped))
        for lidar in ("LDS-01", "LDS-02"):
            whole, part, floor = _times(policy, scans(lidar), products(policy))
            for label, percentile in (("median", 50), ("p99", 99)):
                least = _percentile(floor, percentile)
                against = f"its matrix products alone, {least:.2f} us"
                for what, times in (("resampling", part), ("scan to command", whole)):
                    value = _percentile(times, percentile)
                    out.append(row(f"{what}, {name}, {lidar}, {label}", value, "us", against, value / least))
    return out


def _percentile(times: np.ndarray, percentile: int) -> float:
    """Return a percentile of `times` (n,) within a stretch, in the median of all stretches."""
    return float(np.median(np.percentile(times.reshape(STRETCHES, STRETCH), percentile, axis=1)))


def _times(
    policy: KoopmanPolicy, given: list[tuple[np.ndarray, ScanGeometry]], multiply: Callable[[], None]
) -> np.ndarray:
    """Return how long the whole, resampling alone and the floor took (3, n) [us], one after the other."""
    times = []
    sectors = replace(policy.sectors)  # it has not seen the scan yet when it is its turn
    for ranges, geometry in given:
        marks = [time.perf_counter()]
        policy.decide(ranges, geometry, 0.1, 0.2)
        marks.append(time.perf_counter())
        sectors.distances(ranges, geometry)
        marks.append(time.perf_counter())
        multiply()
        marks.append(time.perf_counter())
        times.append(np.diff(marks))
    return 1e6 * np.array(times[WARM_UP:]).T


if __name__ == "__main__":
    print(*rows(), sep="\n")
