"""Solve a task's optimal control problem from one start, and draw the trajectory.

python examples/mpc_trajectory.py [PICTURE]
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

from ctrl_rl_core import draw_map, load_navigation_task, save_figure
from oc_baseline_node import Mpc, formulate

task = load_navigation_task("car_navigation")
problem = formulate(task)
start = np.array([-3.5, -3.5, 0.8])  # x [m], y [m], heading [rad]
trajectory = Mpc(problem).solve(start)
if not trajectory.solved:
    raise SystemExit(f"no trajectory from {start}: {trajectory.reason}")
print(f"{problem.horizon} steps of {trajectory.time_step} s, cost {trajectory.cost:.3g}")
print(f"ends at {trajectory.states[-1].round(2)}")

figure, axes = plt.subplots(figsize=(5, 5))
draw_map(axes, task)
axes.plot(*trajectory.states[:, problem.positions].T)
picture = Path(sys.argv[1] if len(sys.argv) > 1 else "mpc_trajectory.png")
save_figure(figure, picture)
print(f"picture: {picture}")
