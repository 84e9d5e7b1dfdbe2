"""Figures of times to reach, of their cost, and of training."""

import json
from dataclasses import replace

import numpy as np
import pytest
from picture_faults import RESULTS, assert_clean, figures_of
from ttr_reward_node.plots import draw_slices
from ttr_reward_node.plots.cost import draw_cost
from ttr_reward_node.training.plots import Learning, draw_all

from ctrl_rl_core import Axis, ValueGrid, load_navigation_task


@pytest.mark.parametrize("name", ["car_ttr", "quad_ttr"])
def test_learning_by_the_time_to_reach(drawn, tmp_path, name):
    figures = figures_of(f"ttr_training_{name}", Learning)
    assert len(list(draw_all(figures, load_navigation_task(name), "ppo", tmp_path))) == 4
    assert_clean(drawn)


def test_values(drawn, tmp_path):
    task = load_navigation_task("car_ttr")
    axes = [Axis("x", "m", -5.0, 5.0, 21), Axis("y", "m", -5.0, 5.0, 21), Axis("theta", "rad", -np.pi, np.pi, 8, True)]
    x, y = np.meshgrid(axes[0].nodes, axes[1].nodes, indexing="ij")
    distance = np.repeat(np.hypot(x - 4.0, y - 4.0)[..., None], 8, axis=2)
    time = ValueGrid(distance.astype(np.float32), tuple(axes), "time_to_reach", task.name, "0" * 64, "none", 0.0)
    draw_slices(time, task, tmp_path / "time.png")
    draw_slices(replace(time, kind="avoid", values=time.values - 5.0), task, tmp_path / "safe.png")
    assert_clean(drawn)


def test_cost_of_the_solver(drawn, tmp_path):
    rows = {}
    for row in json.loads((RESULTS / "ttr_cost.json").read_text())["rows"]:
        system, _, points = row["method"].rpartition(", ")
        if row["metric"] == "CPU time":
            rows[row["method"]] = {"system": system, "points": int(points.split()[0].replace(",", "")),
                                   "cpu_s": row["mean"], "method": "semi_lagrangian"}  # fmt: skip
    draw_cost(list(rows.values()), tmp_path / "cost.svg")
    assert_clean(drawn)
