"""Figures of learning Koopman policies and of their analysis."""

import json

import pytest
from koopman_lqr_controller.training.analysis.plots import draw_all
from koopman_lqr_controller.training.experiments.plots import draw
from picture_faults import RESULTS, ROOT, assert_clean


@pytest.mark.parametrize(
    "file",
    [*RESULTS.glob("koopman_figure*.json"), RESULTS / "koopman_last_policy.json", RESULTS / "koopman_cheetah_run.json"],
    ids=lambda file: file.stem,
)
def test_learning_of_koopman_policies(drawn, tmp_path, file):
    draw(file, tmp_path / "koopman.svg")
    assert_clean(drawn)


@pytest.mark.parametrize("folder", [file.parent for file in ROOT.glob("docs/analysis/*/analysis.json")])
def test_analyses(drawn, tmp_path, folder):
    assert draw_all(json.loads((folder / "analysis.json").read_text()), tmp_path)
    assert_clean(drawn)
