"""Memory is checked before it is allocated; machine code is cached between processes."""

import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from ctrl_rl_core.io import available_memory
from ctrl_rl_core.values import cached_njit
from numba.core.caching import NullCache
from numba.core.dispatcher import Dispatcher
from ttr_reward_node.kernels.entry_points import KERNEL_FILES

from ttr_reward_node import METHODS, TimeToReachError, memory_needed, problem_from_task, solve

_SOLVE = """
from ttr_reward_node.kernels.entry_points import kernels
from ttr_reward_node.problems.from_task import problem_from_task
from ttr_reward_node.solvers.solver import solve
solve(problem_from_task("car_ttr", counts=(21, 21, 18)), "lax_friedrichs")  # it compiles soonest
stats = kernels().lax_friedrichs.stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""

_PEAK = """
import sys
from pathlib import Path
from ttr_reward_node.verification.cost import make_problem
from ttr_reward_node.solvers.solver import memory_needed, solve

def status(key):
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024.0 * next(float(line.split()[1]) for line in lines if line.startswith(key))

name, points, method = sys.argv[1:]
problem = make_problem(name, float(points))
before = status("VmRSS:")
solve(problem, method, max_sweeps=1)
print(status("VmHWM:") - before, memory_needed(problem, method))
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="asks Linux for the peak")
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("name", "points"), [("3D Dubins car", 6e6), ("4D planar quadrotor, half", 1e6)])
def test_no_more_is_taken_than_was_stated(name, points, method):
    run = subprocess.run(
        [sys.executable, "-c", _PEAK, name, str(points), method], check=True, capture_output=True, text=True
    )
    peak, stated = map(float, run.stdout.split())
    assert peak <= stated
    assert stated <= 4.0 * peak  # a larger estimate would reject problems that fit


@pytest.mark.parametrize("method", METHODS)
def test_what_does_not_fit_is_refused_before_anything_is_computed(method):
    huge = problem_from_task("quad_ttr", counts=(200,) * 6)
    assert memory_needed(huge, method) > 1e12
    with pytest.raises(TimeToReachError, match=r"64,000,000,000,000 grid points need .* GB"):
        solve(huge, method)


def test_need_grows_with_the_grid_and_fits_here():
    small, large = (memory_needed(problem_from_task("car_ttr", counts=c)) for c in ((51, 51, 36), (101, 101, 72)))
    assert small < large < available_memory()


def test_second_process_compiles_nothing(tmp_path: Path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    hits = [
        subprocess.run([sys.executable, "-c", _SOLVE], env=environment, check=True, capture_output=True, text=True)
        for _ in range(2)
    ]
    first, second = (tuple(map(int, run.stdout.split())) for run in hits)
    assert first == (0, 1)
    assert second == (1, 0)


def test_only_the_entry_points_keep_machine_code():
    """A cached inner function would miss changes in its callees."""
    for name in KERNEL_FILES:
        for function in vars(import_module(f"ttr_reward_node.kernels.{Path(name).stem}")).values():
            if isinstance(function, Dispatcher):
                assert isinstance(function._cache, NullCache)


def test_without_a_place_for_machine_code_it_is_made_anew(monkeypatch):
    """As in a read-only installation without a home directory."""

    def refuse(*_arguments, **_options):
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(Dispatcher, "enable_caching", refuse)
    assert cached_njit(lambda x: x + 1.0)(1.0) == 2.0
