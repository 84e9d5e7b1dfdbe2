"""Doors to the learning commands: where the packages that they need are missing, one line says what to install."""

from ctrl_rl_core.command import run_imported

_MODULE = "oc_baseline_node.training.cli"


def train() -> int:
    """Learn a task's sparse reward with policy gradients."""
    return run_imported("train", _MODULE, "train")


def training_figures() -> int:
    """Draw what `train` wrote."""
    return run_imported("training_figures", _MODULE, "training_figures")
