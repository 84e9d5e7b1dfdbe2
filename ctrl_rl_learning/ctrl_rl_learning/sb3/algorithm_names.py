"""Names of the algorithms, in a module of their own so that --help does not import torch."""

THESIS_ALGORITHMS = ("ppo", "trpo", "ddpg")
"""Algorithms that the thesis compares."""
ALGORITHMS = (*THESIS_ALGORITHMS, "sac")
"""Names that `ctrl_rl_learning.sb3.algorithms.make_algorithm` accepts."""
