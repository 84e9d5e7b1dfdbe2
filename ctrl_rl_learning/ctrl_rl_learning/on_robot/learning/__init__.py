"""Fine-tuning of a policy from few steps."""
