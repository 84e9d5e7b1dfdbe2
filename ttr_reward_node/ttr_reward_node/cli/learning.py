"""Doors to the learning commands: where the packages that they need are missing, one line says what to install."""

from ctrl_rl_core.command import run_imported

_MODULE = "ttr_reward_node.training.cli"


def train() -> int:
    """Learn a task with rewards and algorithms."""
    return run_imported("train", _MODULE, "train")


def training_figures() -> int:
    """Draw what `train` wrote."""
    return run_imported("training_figures", _MODULE, "training_figures")
