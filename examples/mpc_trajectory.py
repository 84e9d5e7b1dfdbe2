"""Solve a task's optimal control problem from one start, and draw the trajectory.

python examples/mpc_trajectory.py [PICTURE]
"""

import sys
from pathlib import Path

import numpy as np

from ctrl_rl_core import load_navigation_task
from oc_baseline_node import Mpc, draw_trajectories, formulate

task = load_navigation_task("car_navigation")
problem = formulate(task)
start = np.array([-3.5, -3.5, 0.8])  # x [m], y [m], heading [rad]
trajectory = Mpc(problem).solve(start)
if not trajectory.solved:
    raise SystemExit(f"no trajectory from {start}: {trajectory.reason}")
print(f"{problem.horizon} steps of {trajectory.time_step} s, cost {trajectory.cost:.3g}")
print(f"ends at {trajectory.states[-1].round(2)}")

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "mpc_trajectory.png")
draw_trajectories(task, [trajectory.states], picture)
print(f"picture: {picture}")
