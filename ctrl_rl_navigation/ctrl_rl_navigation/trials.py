"""Door to the trials: where the simulator is missing, one line says what to install."""

from functools import partial

from ctrl_rl_core.command import run_imported

trials = partial(run_imported, "trials", "ctrl_rl_navigation.cli.trials", "main")
