"""The time to reach a goal on a map: speeds, fast marching, the value, and its solver."""
