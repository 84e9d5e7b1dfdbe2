"""From value, pose and scan to a command: look-ahead, obstacles that the map has not, and the navigator."""
