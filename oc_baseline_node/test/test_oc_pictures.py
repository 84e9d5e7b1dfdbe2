"""Figures of optimal-control values and of learning with them."""

import pytest
from oc_baseline_node.plots import draw_heat_map
from oc_baseline_node.training.plots import Learning, draw_all
from picture_faults import assert_clean, figures_of

from ctrl_rl_core import load_navigation_task
from oc_baseline_node import find_value, load_value


@pytest.mark.parametrize("name", ["car_navigation", "quad_navigation", "quad_trap"])
def test_learning_with_optimal_control(drawn, tmp_path, name):
    list(draw_all(figures_of(f"oc_training_{name}", Learning), load_navigation_task(name), tmp_path))
    assert_clean(drawn)


def test_optimal_control_value(drawn, tmp_path):
    task = load_navigation_task("car_navigation")
    draw_heat_map(load_value(find_value("car_navigation")), task, tmp_path / "value.png", cells=40)
    assert_clean(drawn)
