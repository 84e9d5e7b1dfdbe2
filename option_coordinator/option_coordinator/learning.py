"""Entry points of the learning commands; one line says what to install if their packages are missing."""

from functools import partial

from ctrl_rl_core.command import run_imported

_MODULE = "option_coordinator.training.cli.learning"
evaluate, train, plot, training_figures = (
    partial(run_imported, name, _MODULE, name) for name in ("evaluate", "train", "plot", "training_figures")
)
loop = partial(run_imported, "loop", "option_coordinator.training.cli.loop", "loop")
evaluate_offline = partial(
    run_imported, "evaluate_offline", "option_coordinator.training.cli.offline", "evaluate_offline"
)
