"""Learning with Stable-Baselines3."""
