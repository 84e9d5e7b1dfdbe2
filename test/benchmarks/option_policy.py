"""What a decision costs: a mixture policy's conditional, half of the robots asking, against the number of robots.

python test/benchmarks/option_policy.py FILE.svg draws what docs/results/bench.json holds of it.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from _common import Row, row
from option_coordinator.training import as_numpy, make_head

from ctrl_rl_core import read_benchmarks
from option_coordinator import Agent, OptionPolicy, PolicyQuery, learned_policy_fn

ROBOTS = (2, 5, 10, 20, 50, 100, 150, 200, 300)
OPTIONS = 6
DECISIONS = 300
RESULTS = Path(__file__).parents[2] / "docs" / "results" / "bench.json"


def rows() -> list[Row]:
    """Return the median time of a decision for each number of robots, with the ratio to two robots'."""
    times = {robots: decision_time(robots) for robots in ROBOTS}
    least = times[ROBOTS[0]]
    return [
        row(f"decision for {robots} robots", took, "ms", f"{ROBOTS[0]} robots, {least:.3f} ms", took / least)
        for robots, took in times.items()
    ]


def decision_time(robots: int) -> float:
    """Return the median time of a decision [ms], observations and running options drawn anew for each."""
    agents = tuple(Agent(f"r{i}", tuple("abcdef"[:OPTIONS]), 4) for i in range(robots))
    policy = OptionPolicy(agents, "mixture", False, as_numpy(make_head("mixture", agents)))
    random = np.random.default_rng(0)
    chooses = learned_policy_fn(policy, random)
    times = []
    for _ in range(DECISIONS):
        choosing = random.permutation(robots) < max(1, robots // 2)
        choice = PolicyQuery(
            observation=random.normal(size=4 * robots).astype(np.float32),
            choosing=choosing,
            running=np.where(choosing, -1, random.integers(OPTIONS, size=robots)),
            legal=np.ones((robots, OPTIONS), bool),
        )
        begin = time.perf_counter()
        chooses(choice)
        times.append(1e3 * (time.perf_counter() - begin))
    return float(np.median(times))


def draw(path: Path) -> None:
    """Write the picture of cost against number of robots, as it was measured."""
    from ctrl_rl_core.plots import OURS_COLOUR, name_at_end, picture

    measured = {each.name: each.value for each in read_benchmarks(RESULTS)}
    times = [measured[f"decision for {robots} robots"] for robots in ROBOTS]
    title = f"A decision takes {times[0]:.2f} ms for {ROBOTS[0]} robots, {times[-1]:.2f} ms for {ROBOTS[-1]}"
    with picture(path, title, height=2.6) as (_, ((axes,),)):
        axes.plot(ROBOTS, times, "o-", color=OURS_COLOUR)
        name_at_end(axes, f"median of {DECISIONS}\ndecisions", times[-1], OURS_COLOUR)
        axes.set(xlabel="robots, half of them asking", ylabel="decision [ms]", ylim=(0.0, None))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        draw(Path(sys.argv[1]))
    else:
        print(*rows(), sep="\n")
