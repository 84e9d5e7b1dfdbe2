"""The robot on topics: what it senses, what it is told, and who tells it."""
