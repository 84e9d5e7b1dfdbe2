"""The base of every node: parameters, executor, signals, diagnostics, and serving of values."""
