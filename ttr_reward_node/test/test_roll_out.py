"""Roll-outs by the solution: executed against predicted time."""

import numpy as np
import pytest
from ttr_reward_node.verification.check import random_starts

from ttr_reward_node import TimeToReachError, check_task, problem_from_task, roll_out, solve


def test_without_obstacles_time_is_as_predicted():
    result = check_task("car_ttr", obstacles=False, states=400)
    assert result["reached"] >= 0.98
    assert result["ratio_median"] == pytest.approx(1.0, abs=0.01)
    assert result["ratio_p95"] <= 1.02


def test_among_obstacles_it_arrives():
    result = check_task("car_ttr", states=300)
    assert result["reached"] >= 0.95
    assert result["collided"] <= 0.04
    assert result["ratio_median"] == pytest.approx(1.0, abs=0.01)


def test_start_without_a_time_is_refused():
    problem = problem_from_task("car_ttr", counts=(31, 31, 24))
    grid = solve(problem).grid
    with pytest.raises(TimeToReachError, match="is not finite: start from another state"):
        roll_out(grid, problem, [[0.0, 0.0, 0.0]])
    assert np.isfinite(grid.value(random_starts(grid, problem, 50))).all()
