"""Constants of robots, and their motion under commands."""
