"""Ways to use the time to reach in reinforcement learning."""
