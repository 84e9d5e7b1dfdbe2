"""Worker processes, signals, and exclusive locks."""
