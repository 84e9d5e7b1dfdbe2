"""The commands that learn joint options."""
