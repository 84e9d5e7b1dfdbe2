"""Solve the time to reach of a task, evaluate it at a few states, and draw a slice of it.

python examples/time_to_reach_slice.py [PICTURE]
"""

import sys
from pathlib import Path

from ttr_reward_node.plots import draw_slices

from ctrl_rl_core import load_navigation_task
from ttr_reward_node import problem_from_task, solve

task = load_navigation_task("car_ttr")
problem = problem_from_task(task, counts=(61, 61, 48), inflation=task.robot.radius)
solution = solve(problem)
print(f"solved in {solution.sweeps} sweeps, the goal can be reached from {solution.reachable:.0%} of the grid")

states = [[0.0, -3.0, 1.0], [3.0, 3.0, 0.75]]  # x [m], y [m], heading [rad]
for state, seconds in zip(states, solution.grid.value(states), strict=True):
    print(f"from {state} it takes {seconds:.2f} s")

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "time_to_reach.png")
draw_slices(solution.grid, task, picture, at={"theta": [0.75]})
print(f"picture: {picture}")
