"""Constants of robots, and the motion that follows from a command."""
