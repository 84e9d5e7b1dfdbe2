"""Ways to use a time to reach in learning."""
