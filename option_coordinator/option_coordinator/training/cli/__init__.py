"""The commands for learning joint options."""
