"""Memory is asked for before it is taken; machine code is kept between processes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.memory import available
from ttr_reward_node.problem import problem_from_task
from ttr_reward_node.solver import METHODS, memory_needed, solve

_SOLVE = """
from ttr_reward_node.compiled import kernels
from ttr_reward_node.problem import problem_from_task
from ttr_reward_node.solver import solve
solve(problem_from_task("car_ttr", counts=(21, 21, 18)))
print(sum(kernels().sweep.stats.cache_hits.values()), sum(kernels().sweep.stats.cache_misses.values()))
"""


@pytest.mark.parametrize("method", METHODS)
def test_what_does_not_fit_is_refused_before_anything_is_computed(method):
    huge = problem_from_task("quad_ttr", counts=(200,) * 6)
    assert memory_needed(huge, method) > 1e12
    with pytest.raises(TimeToReachError, match=r"64,000,000,000,000 grid points need .* GB"):
        solve(huge, method)


def test_need_grows_with_the_grid_and_fits_here():
    small, large = (memory_needed(problem_from_task("car_ttr", counts=c)) for c in ((51, 51, 36), (101, 101, 72)))
    assert small < large < available()


def test_second_process_compiles_nothing(tmp_path: Path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    hits = [
        subprocess.run([sys.executable, "-c", _SOLVE], env=environment, check=True, capture_output=True, text=True)
        for _ in range(2)
    ]
    first, second = (tuple(map(int, run.stdout.split())) for run in hits)
    assert first == (0, 1)
    assert second == (1, 0)
