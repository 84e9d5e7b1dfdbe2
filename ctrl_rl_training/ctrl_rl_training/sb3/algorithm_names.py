"""What the algorithms are called; apart from them, because a command's --help need not wait for torch."""

ALGORITHMS = ("ppo", "trpo", "ddpg")
"""Names of `ctrl_rl_training.sb3.algorithms.make_algorithm`."""
