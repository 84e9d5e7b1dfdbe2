"""The command `train`, which was once the name of `edmd`: only what is asked for is imported."""

import sys

from ctrl_rl_core.old_names import note_old_name


def train() -> int:
    """Learn from interaction. With a policy to write it is the old name of `edmd`, which learns from bags."""
    if any(word.partition("=")[0] == "--output" for word in sys.argv[1:]):
        note_old_name("train", "train BAG ... --output FILE", "edmd")
        from koopman_lqr_controller.cli.edmd import main as learn
    else:
        from koopman_lqr_controller.cli.learn import train as learn
    return learn()
