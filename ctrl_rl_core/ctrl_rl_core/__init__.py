"""What every package shares: robot system models, tasks, value grids, bags, the recorder."""
