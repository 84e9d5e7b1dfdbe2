"""Shortcuts of the sweeps: whole slabs for short rows, and the choice of nodes near target and obstacles."""

import math

import numpy as np
import pytest
from ttr_reward_node.kernels.boundary_conditions import FIXED, FREE, NEAR
from ttr_reward_node.kernels.stencil import StepTable, make_grid
from ttr_reward_node.kernels.sweep import SweepSettings
from ttr_reward_node.solvers import sweeper
from ttr_reward_node.solvers.near_nodes import find_near_nodes
from ttr_reward_node.solvers.node_flags import flag_nodes
from ttr_reward_node.solvers.steps import make_layout
from ttr_reward_node.solvers.tabulation import make_steps
from ttr_reward_node.verification.cost import make_problem

from ttr_reward_node import problem_from_task

RATE = 0.01  # rate of the transform w = exp(-RATE phi) [1/s]
QUADROTOR = {"x": 9, "v_x": 8, "z": 9, "v_z": 8, "psi": 8, "omega": 5}


def test_slabs_follow_the_rule_of_rows():
    """Twelve slabs are computed from given values of all others, by row and as a whole, in each phase."""
    problem = problem_from_task("quad_ttr", counts=QUADROTOR)
    layout, steps, flags, table, grid = _tables(problem)
    near = find_near_nodes(problem, layout, steps, flags, table, grid, RATE)
    random = np.random.default_rng(0)
    some = np.zeros(layout.slabs, dtype=bool)
    some[random.choice(layout.slabs, 12, replace=False)] = True
    fixed = near.flags & FIXED > 0
    open_ = np.repeat(some, near.flags.size // layout.slabs) & ~fixed
    closed = ~open_ & ~fixed
    places = np.indices(layout.counts).reshape(len(layout.counts), -1)
    times = 0.3 * np.abs(places - 0.5 * layout.counts[:, None]).sum(axis=0) + 0.02 * random.random(near.flags.size)
    given = np.where((places[0] == 0) | (random.random(times.size) < 0.02), 0.0, np.exp(-RATE * times))
    given = np.where(fixed, near.values, np.where(open_, 0.0, given)).astype(np.float32)
    first = SweepSettings(RATE, math.inf, 0.0, 0.0, False, 0, 0)
    sharp = first._replace(jump=2.0, enough=0.75)
    for phase in (first, sharp, sharp._replace(curved=True)):
        found = []
        for kind in (sweeper._RowSweeper, sweeper._SlabSweeper):
            sweeps = kind(grid, table, near, 1)
            sweeps.values[:] = given
            sweeps.restart(closed)
            for number in range(1, 10):
                sweeps.sweep(phase._replace(number=number, bits=number), number)
            found.append(sweeps.values[open_])
        assert np.mean(found[0] > 0.0) > 0.2
        np.testing.assert_allclose(found[1], found[0], rtol=2e-5, atol=1e-6)


def _tables(problem):
    layout = make_layout(problem)
    steps, reach = make_steps(problem, layout)
    flags = flag_nodes(problem, layout, reach)
    discounts = np.exp(-RATE * steps.durations).astype(np.float32)
    discounts[0] = 0.0
    long = steps.lengths > 3.5
    table = StepTable(steps.codes, steps.ends, steps.ranges, long, steps.controls, discounts, steps.durations)
    axes = len(layout.order)
    return layout, steps, flags, table, make_grid(layout.counts[:axes], layout.periodic[:axes], len(layout.outer))


@pytest.mark.parametrize("name", ["car", "quadrotor", "bicycle"])
def test_no_node_that_a_step_could_end_near_is_left_out(name):
    counts = {"car": {"x": 25, "y": 25, "theta": 12}, "quadrotor": QUADROTOR}
    tasks = {"car": "car_ttr", "quadrotor": "quad_ttr"}
    problem = problem_from_task(tasks[name], counts=counts[name]) if name in tasks else make_problem("4D bicycle", 1e4)
    layout, steps, flags, table, grid = _tables(problem)
    everywhere = np.where(flags == FREE, np.uint8(NEAR), flags)
    some = find_near_nodes(problem, layout, steps, flags, table, grid, RATE)
    every = find_near_nodes(problem, layout, steps, everywhere, table, grid, RATE)
    assert np.array_equal(some.flags, every.flags)
    assert np.array_equal(some.outcomes, every.outcomes)
