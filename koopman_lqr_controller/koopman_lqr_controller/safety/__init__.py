"""Guards that compare a robot's latents and prediction errors with those of training."""
