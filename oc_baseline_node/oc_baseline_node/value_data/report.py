"""Reports on value data and a fit: text lines, and rows of a results file."""

from __future__ import annotations

import numpy as np

from ctrl_rl_core import Result
from oc_baseline_node.problems.problem import MODELS_OWN, OptimalControlProblem
from oc_baseline_node.problems.start_states import draw_episode_start
from oc_baseline_node.value_data.dataset import ValueData
from oc_baseline_node.values.mlp_value import MlpValue

_EPISODES = 10
"""Number of episode starts tried by `oc data`."""


def remarks(problem: OptimalControlProblem, rounded: tuple[str, ...]) -> list[str]:
    """Return remarks on controls not bounded by the task file, and on smoothed operations of the model.

    Args:
        problem: Optimal control problem.
        rounded: Operations of the model that were smoothed.
    """
    lines = [
        f"control       {control.name} {control.lower:g} .. {control.upper:g} {control.unit}: {source}\n"
        for control, source in zip(problem.system.controls, problem.sources, strict=True)
        if source == MODELS_OWN
    ]
    if rounded:
        names = ", ".join(rounded)
        lines.append(f"rounded off   {names}: no derivative somewhere; the model itself checks each trajectory\n")
    return lines


def start_set(problem: OptimalControlProblem, seed: int) -> str:
    """Report how many episode starts have a trajectory; the data's own starts cover the whole map."""
    from oc_baseline_node.mpc.mpc import Mpc

    mpc, random = Mpc(problem), np.random.default_rng(seed)
    found = [mpc.solve(draw_episode_start(problem, random)) for _ in range(_EPISODES)]
    lacking = [each.reason for each in found if not each.solved]
    first = f"start set     {_EPISODES - len(lacking)} of {_EPISODES} starts of an episode have a trajectory"
    return "\n".join([first, *(f"              {lacking.count(each)} {each}" for each in sorted(set(lacking)))])


def report(data: ValueData) -> str:
    """Report how many starts have a trajectory, and the reasons for those without."""
    solved, in_all = len(data.states), data.cpu_seconds.sum() + data.wasted_seconds.sum()
    lines = [
        f"trajectories  {solved} of {data.states.shape[1] - 1} steps",
        f"success       {data.success_rate:.1%} of {data.starts} random starts; {data.success_rate_of_viable:.1%} of "
        "those that can keep clear for a second",
        f"dropped       {len(data.unsolved)} starts without a trajectory{':' if data.dropped else ''}",
        *(f"              {count} {reason}" for reason, count in data.dropped.items()),
        f"CPU seconds   {data.cpu_seconds.mean():.3f} mean, {np.percentile(data.cpu_seconds, 95):.3f} p95 "
        f"per trajectory; {in_all / solved:.3f} with the failed starts",
    ]
    return "\n".join(lines)


def value_rows(data: ValueData, value: MlpValue) -> list[Result]:
    """Return result rows on generating the data and on the error of V_oc; the thesis has 800 x 140 states."""
    count, horizon = len(data.states), data.states.shape[1] - 1
    tried, doomed = data.starts, int(data.doomed.sum())
    unseen, seconds = value.manifest["held_out"], data.cpu_seconds
    in_all = float(seconds.sum() + data.wasted_seconds.sum())
    spread = unseen["std_of_values"]
    rows: list[tuple[str, str, str, float, float | None]] = [
        ("MPC", "states", "1", count * horizon, 800.0 * 140.0),
        ("MPC", "starts with a trajectory", "of all", data.success_rate, None),
        ("MPC", "starts that cannot keep clear for 1 s", "of all", doomed / tried, None),
        ("MPC", "starts with a trajectory, of those that can", "of them", data.success_rate_of_viable, None),
        *(("MPC", f"starts dropped: {reason}", "of all", n / tried, None) for reason, n in data.dropped.items()),
        ("MPC", "time of a trajectory, mean", "CPU s", float(seconds.mean()), None),
        ("MPC", "time of a trajectory, 95th percentile", "CPU s", float(np.percentile(seconds, 95)), None),
        ("MPC", "time of a trajectory, with starts in vain", "CPU s", in_all / count, None),
        ("V_oc, held-out trajectories", "mean absolute error", "reward", unseen["mae"], None),
        ("V_oc, held-out trajectories", "root mean square error", "reward", unseen["rmse"], None),
        ("V_oc, held-out trajectories", "standard deviation of the values", "reward", spread, None),
        ("V_oc, held-out trajectories", "variance explained", "1", 1.0 - (unseen["rmse"] / spread) ** 2, None),
    ]
    return [Result(method, metric, unit, [number], thesis) for method, metric, unit, number, thesis in rows]
