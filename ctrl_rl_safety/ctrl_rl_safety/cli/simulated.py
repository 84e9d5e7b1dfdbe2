"""Doors to commands that need the simulator: where it is missing, one line says what to install."""

from functools import partial

from ctrl_rl_core.command import run_imported

trials = partial(run_imported, "trials", "ctrl_rl_safety.trials.command", "main")
train = partial(run_imported, "train", "ctrl_rl_safety.training.command", "train")
