"""The ladder of tasks: its files, how hard each is, its runs, and their table and pictures."""
