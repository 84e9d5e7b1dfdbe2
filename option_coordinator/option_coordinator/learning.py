"""Entry points of the learning commands; one line says what to install if their packages are missing."""

from functools import partial

from ctrl_rl_core.command import run_imported

_NAMES = ("evaluate", "evaluate_offline", "loop", "plot", "train", "training_figures")
evaluate, evaluate_offline, loop, plot, train, training_figures = (
    partial(run_imported, name, "option_coordinator.training.cli.learning", name) for name in _NAMES
)
