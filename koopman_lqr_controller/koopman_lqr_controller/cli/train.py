"""The command `train`, also the former name of `edmd`; imports only what is needed."""

import sys

from ctrl_rl_core.old_names import note_old_name


def train() -> int:
    """Learn from interaction; given a policy file to write, act as `edmd`, the command that had this name."""
    if any(word.partition("=")[0] == "--output" for word in sys.argv[1:]):
        note_old_name("train", "train BAG ... --output FILE", "edmd")
        from koopman_lqr_controller.cli.edmd import main as learn
    else:
        from koopman_lqr_controller.cli.learn import train as learn
    return learn()
