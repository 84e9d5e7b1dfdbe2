"""Whole trajectories of the optimal control problems: ipopt, fatrop, both in turn, from a plan, the letter of Eq. 3.16.

Every way of solving gets the same random starts in the same run, from all over the map and then from the task's start
set; times are CPU seconds without setting up.
"""

from __future__ import annotations

import numpy as np
from _common import Row, row

from ctrl_rl_core import load_navigation_task
from oc_baseline_node import Mpc, MpcSolution, draw_start, formulate, shift_trajectory

STARTS = {"car_navigation": 40, "quad_navigation": 25, "quad_trap": 25}
LETTER_STARTS = 15
START_SET = 10
"""Starts from each task's start set."""


def rows() -> list[Row]:
    """Return CPU seconds per start and success rates, beside ipopt from a cold start: how many times faster."""
    out = []
    for name, count in STARTS.items():
        problem = formulate(load_navigation_task(name))
        random = np.random.default_rng(0)
        starts = [draw_start(problem, random) for _ in range(count)]
        ipopt, fatrop, both = (Mpc(problem, solvers) for solvers in (("ipopt",), ("fatrop",), ("fatrop", "ipopt")))
        peer = [ipopt.solve(start) for start in starts]
        ours = [fatrop.solve(start) for start in starts]
        out.append(_time(f"MPC {name}, fatrop", ours, "ipopt", peer))
        out.append(_time(f"MPC {name}, fatrop, ipopt where it fails", [both.solve(s) for s in starts], "ipopt", peer))
        plans = [trajectory for trajectory in ours if trajectory.solved]
        interior_point = Mpc(problem, ("fatrop",), nearby=False)
        warm, again = ([_next(mpc, plan) for plan in plans] for mpc in (fatrop, interior_point))
        out.append(_time(f"MPC {name}, warm start one step on", warm, "fatrop from the same plan", again))
        own = [problem.task.start.region.sample(problem.system.state_names, random) for _ in range(START_SET)]
        theirs, mine = ([mpc.solve(start) for start in own] for mpc in (ipopt, both))
        out.append(_time(f"MPC {name}, from the start set", mine, "ipopt", theirs))
        if name == "car_navigation":
            letter = Mpc(formulate(problem.task, "letter"), ("ipopt",))
            some = [letter.solve(start) for start in starts[:LETTER_STARTS]]
            out.append(_rate("MPC car_navigation, Eq. 3.16 to the letter, success", some, "free speed", ours))
    return out


def _next(mpc: Mpc, plan: MpcSolution) -> MpcSolution:
    guess = shift_trajectory(plan.states, plan.controls, 1)
    return mpc.solve(plan.states[1], guess, multipliers=mpc.shift(plan.multipliers, 1))


def _time(name: str, ours: list[MpcSolution], other: str, theirs: list[MpcSolution]) -> Row:
    mine, peer = (float(np.mean([t.cpu_seconds for t in some])) for some in (ours, theirs))
    against = f"{other}, {peer:.3f} CPU s; solved {_solved(ours):.0%}, {other} {_solved(theirs):.0%}"
    return row(name, mine, "CPU s", against, peer / mine)


def _rate(name: str, ours: list[MpcSolution], other: str, theirs: list[MpcSolution]) -> Row:
    mine, peer = _solved(ours), _solved(theirs)
    return row(name, mine, "of starts", f"{other}, {peer:.2f}", mine / peer)


def _solved(some: list[MpcSolution]) -> float:
    return float(np.mean([t.solved for t in some]))


if __name__ == "__main__":
    print(*rows(), sep="\n")
