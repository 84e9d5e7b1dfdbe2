"""Statistics of value data and of a fit, as rows of a results file."""

from __future__ import annotations

import numpy as np

from ctrl_rl_core import Result
from oc_baseline_node.value_data.dataset import ValueData
from oc_baseline_node.values.mlp_value import MlpValue


def value_rows(data: ValueData, value: MlpValue) -> list[Result]:
    """Return rows that tell how the data came about and how well V_oc fits them; the thesis has 800 x 140 states."""
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
