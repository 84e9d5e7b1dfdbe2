"""Learning with Stable-Baselines3 in the simulated tasks: what the methods that train policies share."""
