"""Entry points of the learning commands; one line says what to install if their packages are missing."""

from functools import partial

from ctrl_rl_core.command import run_imported

_MODULE = "oc_baseline_node.training.cli"
train, plot, training_figures = (
    partial(run_imported, name, _MODULE, name) for name in ("train", "plot", "training_figures")
)
evaluate = partial(run_imported, "evaluate", "ctrl_rl_learning.cli.evaluate", "evaluate")
export = partial(run_imported, "export", "ctrl_rl_learning.cli.export", "export")
