"""Figures on learning options."""

import pytest
from option_coordinator.training.plots import Learning, draw_curves
from picture_faults import assert_clean, figures_of


@pytest.mark.parametrize("name", ["tool_delivery", "water_filling", "delivery_team", "water_filling_long"])
def test_learning_of_options(drawn, tmp_path, name):
    draw_curves(figures_of(f"options_{name}", Learning), tmp_path / "options.svg")
    assert_clean(drawn)
