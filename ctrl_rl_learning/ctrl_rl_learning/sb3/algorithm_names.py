"""What the algorithms are called; apart from them, because a command's --help need not wait for torch."""

THESIS_ALGORITHMS = ("ppo", "trpo", "ddpg")
"""Algorithms that the thesis compares."""
ALGORITHMS = (*THESIS_ALGORITHMS, "sac")
"""Names of `ctrl_rl_learning.sb3.algorithms.make_algorithm`."""
