"""Doors to the learning commands: where the packages that they need are missing, one line says what to install."""

import sys
from functools import partial

from ctrl_rl_core.command import run_imported
from ctrl_rl_core.old_names import note_old_name

_LEARN, _COMPARE = "koopman_lqr_controller.cli.learn", "koopman_lqr_controller.cli.compare"
learn, consolidate = (partial(run_imported, name, _LEARN, name) for name in ("learn", "consolidate"))
compare, plot, comparison_figures = (
    partial(run_imported, name, _COMPARE, name) for name in ("compare", "plot", "comparison_figures")
)


def train() -> int:
    """Learn from interaction. With a policy to write it is the old name of `edmd`, which learns from bags."""
    if any(word.partition("=")[0] == "--output" for word in sys.argv[1:]):
        note_old_name("train", "train BAG ... --output FILE", "edmd")
        return run_imported("edmd", "koopman_lqr_controller.cli.edmd", "main")
    return run_imported("train", _LEARN, "train")
