"""Tasks that tell learning methods apart, and the comparison of ways to use a value function."""
